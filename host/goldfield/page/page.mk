# The live page: TypeScript to a few files that the host serves. It needs npm, which most users of a checkout do not have:
# without it everything but `goldfield view` works, and that says so. A wheel holds the built page.
PAGE := host/goldfield/page/built/index.html
PAGE_BUILD := $(BUILD)/page
PAGE_SOURCES := $(wildcard host/goldfield/page/web/* host/goldfield/page/web/src/*)

page: $(PAGE) ## The live page of goldfield view, if npm is there

$(PAGE): $(PAGE_SOURCES)
	@mkdir -p $(PAGE_BUILD)
	@if ! command -v npm >/dev/null; then echo "live page: left out, because npm is not installed (with Node.js 20.19 or newer)"; \
	elif ! $(call built_page) >$(PAGE_BUILD)/npm.log 2>&1; then \
	  echo "live page: left out, because npm could not build it: see $(PAGE_BUILD)/npm.log"; \
	else echo "live page: $@"; fi

# Built beside the tree, so that no packages of npm lie in it; `npm ci` takes exactly what package-lock.json names.
define built_page
{ cp -r host/goldfield/page/web/. $(PAGE_BUILD) && \
  { cmp -s $(PAGE_BUILD)/package-lock.json $(PAGE_BUILD)/node_modules/.lock || \
    { (cd $(PAGE_BUILD) && npm ci --no-audit --no-fund) && cp $(PAGE_BUILD)/package-lock.json $(PAGE_BUILD)/node_modules/.lock; }; } && \
  (cd $(PAGE_BUILD) && npm run --silent build) && rm -rf $(@D) && cp -r $(PAGE_BUILD)/built $(@D); }
endef

.PHONY: page
