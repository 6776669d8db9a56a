"""``python -m tests.corpus``: see :mod:`tests.corpus.run`."""

import sys

from tests.corpus.run import main

if __name__ == "__main__":
    sys.exit(main())
