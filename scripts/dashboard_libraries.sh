#!/usr/bin/env bash
# Makes page/libraries.js of isf_dashboard from npm: what the page uses of three.js and uPlot, in one file. It is kept in
# the repository, so that nothing is loaded when the dashboard is built or opened. Needs npm and the network.
set -euo pipefail
page=$(cd "$(dirname "${BASH_SOURCE[0]}")/../ros_ws/src/isf_dashboard/isf_dashboard/page" && pwd -P)
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm install --silent --no-audit --no-fund three@0.187.0 uplot@1.6.32 esbuild@0.25.0
cat >entry.js <<'END'
export {
  AmbientLight, BufferAttribute, BufferGeometry, Color, CylinderGeometry, DirectionalLight, DoubleSide, Group,
  LineBasicMaterial, LineSegments, Mesh, MeshLambertMaterial, PerspectiveCamera, Scene, SphereGeometry, Vector3,
  WebGLRenderer,
} from "three";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
export { default as uPlot } from "uplot";
END
npx esbuild entry.js --bundle --minify --format=esm --legal-comments=none --outfile="$page/libraries.js"
