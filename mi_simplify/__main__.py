"""``python -m mi_simplify`` is the command ``mi-simplify``."""

import sys

from .cli import main

if __name__ == "__main__":
    sys.exit(main())
