#!/usr/bin/env sh
# Writes requirements.lock: the exact versions that satisfy pyproject.toml today, tests and linters included, each with
# the SHA-256 of its files, and requirements-cuda.lock: what a build of torch with CUDA needs besides.
# requirements-docs.lock: what `make docs` needs, in an environment of its own.
# requirements-peers.lock: what `make peers` needs, in another; written by hand, `--peers` renews its hashes alone.
# `torch` is locked without a build tag and with the files of both indices, so that a machine without a GPU may take a
# build without CUDA. `sh scripts/lock.sh PYTHON --keep` keeps the versions of the present lock and renews the hashes, `--docs` writes
# requirements-docs.lock alone.
set -eu
python="$1"
torch="torch==2.13.0"
cpu="${TORCH_CPU_INDEX:-}"   # address of the index that has torch without CUDA
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
"$python" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet "uv>=0.9,<1"
uv="$folder/venv/bin/uv pip compile --quiet --generate-hashes --no-annotate --no-header --python-version 3.11"
names='s/^\([A-Za-z0-9_.-]*==[^ ;\\]*\).*/\1/p'
if [ "${2:-}" = "--peers" ]; then
  sed -n "$names" requirements-peers.lock > "$folder/pins"
  $uv --no-deps "$folder/pins" > "$folder/peers" && mv "$folder/peers" requirements-peers.lock
  exit
fi
"$python" -c 'import tomllib; extras = tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]
print("\n".join(extras["docs"]))' > "$folder/docs"
if [ "${2:-}" = "--docs" ]; then  # the site alone
  $uv "$folder/docs" > "$folder/docs.lock" && mv "$folder/docs.lock" requirements-docs.lock
  exit
fi
if [ "${2:-}" = "--keep" ]; then
  sed -n "$names" requirements.lock > "$folder/pins"
else
  "$python" -m venv "$folder/stack"
  "$folder/stack/bin/python" -m pip install --quiet "$torch" ".[test,lint,crowd]"
  "$folder/stack/bin/python" -m pip freeze --exclude diffstack_mmv | sed 's/+cpu//' | sort -f > "$folder/pins"
  "$folder/stack/bin/python" -m pip freeze --all | grep "^setuptools" >> "$folder/pins"
fi
$uv --no-deps "$folder/pins" > "$folder/hashed"
echo "$torch" > "$folder/torch"
# the builds without CUDA are files of another index; where it cannot be reached, those that pip finds here
if [ -z "$cpu" ] || ! $uv --no-deps --index-url "$cpu" "$folder/torch" > "$folder/cpu" 2> /dev/null; then
  echo "No index in TORCH_CPU_INDEX, or it cannot be reached: only the build of this machine is added." >&2
  "$folder/venv/bin/python" -m pip download --quiet --no-deps --dest "$folder" "$torch"
  sha256sum "$folder"/torch-*.whl | sed 's/^\([0-9a-f]*\) .*/    --hash=sha256:\1/' > "$folder/cpu"
fi
grep -- "--hash" "$folder/cpu" | sed 's/[ \\]*$/ \\/' > "$folder/more"
{
  echo "# Exact versions for Python 3.11 and 3.12, with hashes; written by \`make lock\`."
  sed "/^$torch/r $folder/more" "$folder/hashed"
} > "$folder/lock"
$uv --python-platform linux "$folder/torch" > "$folder/whole"
{
  echo "# What torch with CUDA needs besides requirements.lock; written by \`make lock\`."
  awk -F'==' '{ name = tolower($1); gsub("_", "-", name) } NR == FNR { known[name]; next }
    /^[a-z]/ { wanted = !(name in known) } wanted' "$folder/pins" "$folder/whole"
} > requirements-cuda.lock
mv "$folder/lock" requirements.lock
$uv "$folder/docs" > "$folder/docs.lock" && mv "$folder/docs.lock" requirements-docs.lock
