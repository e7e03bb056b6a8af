#!/usr/bin/env bash
# Builds the pages into web/dist, from where the program embeds them, when something in web/ is newer than the last build.
# Without Node.js and npm it says so in one line and leaves the rest to work without pages.
set -euo pipefail
cd "$(dirname "$0")"

if ! command -v npm > /dev/null || ! node -e '
    const [major, minor] = process.versions.node.split(".").map(Number);
    process.exit(major > 20 || (major === 20 && minor >= 19) ? 0 : 1)' 2> /dev/null; then
    echo "web: the pages are not built: they need Node.js 20.19 or later with npm (https://nodejs.org; Debian 12's is too old); the API works without"
    exit 0
fi
if [ ! -e node_modules/.package-lock.json ] || [ package-lock.json -nt node_modules/.package-lock.json ]; then
    npm ci --no-audit --no-fund --loglevel=error
    touch node_modules/.package-lock.json
fi
newer=$(find package.json vite.config.ts tsconfig.json node.html hub.html src scripts -newer dist/node.html.gz -print -quit 2> /dev/null || echo none)
if [ -e dist/node.html.gz ] && [ -z "$newer" ]; then exit 0; fi
npm run --silent build
