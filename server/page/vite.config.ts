import { readFileSync } from "node:fs";
import { defineConfig } from "vitest/config";

const project = readFileSync(new URL("../../pyproject.toml", import.meta.url), "utf8");
const types = JSON.parse(readFileSync(new URL("../../protocol/interfaces/ros2.json", import.meta.url), "utf8"));
const error_codes: string[][] = types["moveit_msgs/msg/MoveItErrorCodes"].consts;
const version = /^version = "(.+)"$/m.exec(project)?.[1] ?? "";

export default defineConfig({
  // Relative, so that the page also works behind a proxy that serves it under a path.
  base: "./",
  define: {
    // Version of armbridge that the page is built with; the server tells its own.
    __VERSION__: JSON.stringify(version),
    __ERROR_CODE_NAMES__: JSON.stringify(Object.fromEntries(error_codes.map(([, name, value]) => [value, name]))),
  },
  // For `armbridge --version`, which reads no JavaScript.
  plugins: [{
    name: "version",
    transformIndexHtml: () => [{ tag: "meta", attrs: { name: "version", content: version }, injectTo: "head" }],
  }],
  build: {
    outDir: "dist",
    target: "es2022",
    // Every picture stays a file of its own, which the server's policy can name.
    assetsInlineLimit: 0,
    // three alone is above vite's limit of 500 kB, and it is loaded from this very machine.
    chunkSizeWarningLimit: 1500,
    license: { fileName: "licenses.md" },
    rolldownOptions: {
      output: {
        // A fixed name: the server's ETag tells a browser whether the libraries changed.
        chunkFileNames: "assets/[name].js",
        entryFileNames: "assets/[name].js",
        assetFileNames: "assets/[name][extname]",
        // What few visits need is loaded when it is needed: charts, codes, and readers of rarer kinds of meshes.
        codeSplitting: { groups: [{ name: "vendor", test: /node_modules\/(?!uplot|qrcode-generator|.*\/(OBJLoader|ColladaLoader|collada\/))/ }] },
      },
    },
  },
  // Modules are loaded once for all files of tests: a third of the processor time.
  test: { include: ["src/**/*.test.ts"], environment: "node", isolate: false },
});
