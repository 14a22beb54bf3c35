// Paths are relative, because the page may lie behind a token; nothing is inlined, because the page's policy forbids it.
import { defineConfig } from "vite";

export default defineConfig({
  base: "./",
  build: {
    assetsInlineLimit: 0,
    chunkSizeWarningLimit: 1000,
    emptyOutDir: true,
    license: { fileName: "licenses.md" },
    modulePreload: { polyfill: false },
    outDir: "built",
    target: "es2022",
  },
});
