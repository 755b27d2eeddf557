# SPDX-License-Identifier: GPL-3.0-or-later
"""pytest inside Blender; test_in_blender.py starts it.

blender -b --factory-startup --addons amberlight --python run_tests.py -- PYTEST_ARGUMENTS...

Ends Blender with pytest's exit code, or with NO_PYTEST where its Python has none.
"""

import importlib.util
import os
import sys

NO_PYTEST = 77


def main(arguments):
    if importlib.util.find_spec("pytest") is None:
        # Blenders that carry their own Python: Debian's pytest is pure Python and may serve.
        sys.path.append("/usr/lib/python3/dist-packages")
    try:
        import pytest
    except ImportError:
        return NO_PYTEST
    # Warnings of Blender's own scripts are not ours; handles that nobody closed are.
    quiet = ["-p", "no:cacheprovider", "-W", "default", "-W", "error::ResourceWarning"]
    return int(pytest.main([*quiet, *arguments]))


if __name__ == "__main__":
    code = main(sys.argv[sys.argv.index("--") + 1 :])
    sys.stdout.flush()
    sys.stderr.flush()
    # Without Blender's own clean-up, which has nothing to save and may overwrite the exit code.
    os._exit(code)
