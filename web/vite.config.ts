import { defineConfig } from "vite";

// Where `npx vite preview` finds a service to develop against.
const service = process.env.ALBIREO ?? "http://127.0.0.1:8080";
const paths = ["/api", "/healthz", "/readyz", "/metrics", "/openapi.json", "/docs"];

export default defineConfig({
  // Page and parts are served from the root of a node or a hub.
  base: "/",
  build: {
    outDir: "dist",
    // The folder's .gitignore stays: scripts/clean.mjs empties the rest.
    emptyOutDir: false,
    target: "es2022",
    // Data addresses are not in the pages' Content-Security-Policy.
    assetsInlineLimit: 0,
    modulePreload: false,
    reportCompressedSize: false,
    rollupOptions: { input: { node: "node.html", hub: "hub.html" } },
  },
  oxc: { jsx: { runtime: "automatic", importSource: "preact" } },
  preview: { proxy: Object.fromEntries(paths.map((path) => [path, service])) },
  test: { include: ["tests/*.test.ts"], environment: "node" },
} as Parameters<typeof defineConfig>[0]);
