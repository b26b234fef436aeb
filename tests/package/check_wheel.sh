#!/usr/bin/env bash
# Installs the wheel into an empty virtual environment and uses what it brings: check_wheel.sh WHEEL VENV.
set -euo pipefail
here="$(dirname "$(realpath "${BASH_SOURCE[0]}")")"
wheel="$(realpath "$1")"
rm -rf "$2"
python3 -m venv "$2"
bin="$(realpath "$2/bin")"
"$bin/pip" install --quiet --disable-pip-version-check "$wheel"
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
cd "$work"
"$bin/realitysim" --version
# Another linker changes no bit of a tag.
"$bin/realitysim" replay "$here/../../replay/scenes/demo.toml" --check "$here/../../replay/references/demo.jsonl"
"$bin/realitysim" scene render "$here/../../replay/scenes/demo.toml" -o walk.mcap
"$bin/realitysim" log cut walk.mcap --from 0 --to 3 -o piece.mcap
"$bin/realitysim" replay piece.mcap -o captures/
# The program of the environment is found, though the environment is not on PATH.
"$bin/python" "$here/use_wheel.py" captures/*/
"$bin/pip" install --quiet --disable-pip-version-check "mypy==2.4.1"
"$bin/mypy" --strict --cache-dir "$work/mypy" -p realitysim
