#!/bin/sh
# Runs once, when the image is built: a Python of its own, pinned libraries, and a grading as a test.
set -eu

ROOT=${AUTOGRADER_ROOT:-/autograder}
SOURCE=$ROOT/source
VENV=$ROOT/venv

# Hidden tests, solution and secret are for the grader's user only.
chmod -R go-rwx "$SOURCE"

find_python() {
    for candidate in python3.14 python3.13 python3.12 python3.11 python3; do
        if "$candidate" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            command -v "$candidate"
            return 0
        fi
    done
    return 1
}

if [ ! -x "$VENV/bin/python" ]; then
    if ! PYTHON=$(find_python); then
        # Images with Python 3.10 offer a newer one under its own name.
        apt-get update
        apt-get install -y --no-install-recommends python3.12 python3.12-venv ||
            apt-get install -y --no-install-recommends python3.11 python3.11-venv
        PYTHON=$(find_python)
    fi
    "$PYTHON" -m venv "$VENV"
fi
"$VENV/bin/python" -m pip install --quiet --disable-pip-version-check \
    -c "$SOURCE/constraints.txt" -r "$SOURCE/requirements.txt"

chmod +x "$SOURCE/run_autograder" "$SOURCE/run_prairielearn"
PYTHONPATH=$SOURCE/package exec "$VENV/bin/python" -P -m slamcmp.grading.run.autograder self-test
