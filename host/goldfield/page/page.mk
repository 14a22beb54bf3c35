# The live page: TypeScript to a few files that the host serves, by packages of npm. Where its registry is not reached,
# everything but `goldfield view` works, and that says so. A wheel holds the built page.
PAGE := host/goldfield/page/built/index.html
PAGE_BUILD := $(BUILD)/page
PAGE_SOURCES := $(wildcard host/goldfield/page/web/* host/goldfield/page/web/src/*)

page: $(PAGE) ## The live page of goldfield view

$(PAGE): $(PAGE_SOURCES) $(BUILD)/venv.stamp
	@mkdir -p $(PAGE_BUILD)
	@if ! $(call built_page) >$(PAGE_BUILD)/npm.log 2>&1; then \
	  echo "live page: left out, because npm could not build it: see $(PAGE_BUILD)/npm.log"; \
	else echo "live page: $@"; fi

# Built beside the tree, so that no packages of npm lie in it; `npm ci` takes exactly what package-lock.json names.
define built_page
{ cp -r host/goldfield/page/web/. $(PAGE_BUILD) && \
  { cmp -s $(PAGE_BUILD)/package-lock.json $(PAGE_BUILD)/node_modules/.lock || \
    { (cd $(PAGE_BUILD) && $(NPM) ci --no-audit --no-fund) && cp $(PAGE_BUILD)/package-lock.json $(PAGE_BUILD)/node_modules/.lock; }; } && \
  (cd $(PAGE_BUILD) && $(NPM) run --silent build) && rm -rf $(@D) && cp -r $(PAGE_BUILD)/built $(@D); }
endef

.PHONY: page
