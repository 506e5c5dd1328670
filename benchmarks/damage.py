"""
A damaged reduction of a model, to be repaired by `mi-simplify simplify ASSET --init OUT.obj`.

    .venv/bin/python benchmarks/damage.py ../shared/assets/spot/spot.obj 1000 /tmp/damaged_spot.obj

Beside OUT stands the undamaged reduction, OUT with the ending `_whole`.
"""

import argparse
import sys
from pathlib import Path

import mi_simplify as ms

ROOT = Path(__file__).resolve().parents[1]


def main() -> None:
    sys.path.insert(0, str(ROOT / "tests"))
    from support.damage import damaged

    from mi_simplify.formats.obj.write import write_obj

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("asset")
    parser.add_argument("triangles", type=int)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    ms.ensure_variant()
    whole, _ = ms.first_guess(ms.open_asset(args.asset), triangles=args.triangles, atlas_size=512)
    print(write_obj(whole, args.out.with_stem(args.out.stem + "_whole")))
    print(write_obj(damaged(whole, args.seed), args.out))


if __name__ == "__main__":
    main()
