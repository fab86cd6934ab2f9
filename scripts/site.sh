#!/usr/bin/env bash
# Builds the manual and the API reference as a site into .isf/site; a broken link or anchor is an error.
# usage: scripts/site.sh [options of "mkdocs build"]
#   Then open .isf/site/index.html. Browsers search only what comes from a server:
#   python3 -m http.server --directory .isf/site
set -euo pipefail
root=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/.." && pwd -P)
cd "$root"
scripts/setup.sh
# shellcheck source=/dev/null
source "$root/.isf/env.sh"
export NO_MKDOCS_2_WARNING=1 # a banner of the theme, no finding
mkdocs build --strict --quiet "$@"
printf 'Site: %s\n' "$root/.isf/site/index.html"
