# The documentation as a site: build/docs/index.html. docs/site lays the pages out and generates parts of them.
DOCS := $(BUILD)/docs
DOCS_SOURCE := $(BUILD)/docs-source
SPHINX = $(PYTHON) -m sphinx -q -W --keep-going -d $(BUILD)/docs-state -c docs/site $(DOCS_SOURCE)

docs: all ## The documentation as a site, build/docs/index.html, with every link inside checked
	@$(PYTHON) docs/site/stage.py $(DOCS_SOURCE)
	@$(SPHINX) -b html $(DOCS)
	@$(PYTHON) docs/site/check_links.py $(DOCS)
	@echo "docs: $(DOCS)/index.html"

docs-external-links: docs ## Whether the links of the documentation to other sites answer (needs the internet)
	@$(SPHINX) -b linkcheck $(BUILD)/docs-external-links

.PHONY: docs docs-external-links
