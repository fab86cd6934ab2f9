#!/usr/bin/env bash
# Forms a cone over a backing plate on the simulated two-tool machine, with and without springback correction, and writes a report.
# usage: ./demo.sh [options of "isf form"]
set -euo pipefail
root=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")" && pwd -P)
cd "$root"
exec ./isf form examples/jobs/ren_cone_plate_dsif.yaml "$@"
