"""`python -m bench.mutation`: which small changes to the code that refuses wrong answers no test notices."""

from __future__ import annotations

import argparse
import random
import time
from collections.abc import Sequence
from pathlib import Path

from bench.mutation.mutants import Mutant, mutants_of
from bench.mutation.run import Tried, baseline_s, import_all_but, import_libraries, try_mutant
from bench.mutation.survivors import key_of, read_reasons, summary_of
from bench.mutation.targets import TARGETS, Target

PROGRESS_EVERY = 25


def main() -> None:
    """Try the mutants of the modules that are named, or of all; print each one that is not killed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modules", nargs="*", help="parts of the modules' paths; all without")
    parser.add_argument(
        "--share", type=float, default=1.0, help="the share of each module's mutants that is drawn"
    )
    parser.add_argument("--seed", type=int, default=0, help="the seed that they are drawn with")
    parser.add_argument("--figures", action="store_true", help="write docs/figures/mutants.md")
    options = parser.parse_args()
    import_libraries()
    for target in TARGETS:
        if not options.modules or any(part in target.path for part in options.modules):
            mutants = chosen_mutants(target)
            drawn = drawn_mutants(mutants, options.share, options.seed)
            tried = _try_all(target, drawn)
            if options.figures:
                # Later, since it imports modules that are mutated.
                from bench.mutation.report import write_section

                asked = (
                    "" if len(drawn) == len(mutants) else f" --share {options.share:g} --seed {options.seed}"
                )
                write_section(target.path, tried, read_reasons(target.path), asked=asked)


def chosen_mutants(target: Target) -> list[Mutant]:
    """Return the mutants of a target's functions; raises `ValueError` for a function that has none."""
    mutants = list(mutants_of(Path(target.path).read_text(encoding="utf-8")))
    missing = set(target.functions) - {mutant.function for mutant in mutants}
    if missing:
        raise ValueError(f"{target.path} has no mutants in {', '.join(sorted(missing))}.")
    return [mutant for mutant in mutants if not target.functions or mutant.function in target.functions]


def drawn_mutants(mutants: Sequence[Mutant], share: float, seed: int) -> list[Mutant]:
    """Return a random share of mutants, in their order; the same ones for the same seed.

    Raises `ValueError` for a share outside 0 to 1.
    """
    if not 0.0 < share <= 1.0:
        raise ValueError("--share is above 0 and at most 1.")
    rows = random.Random(seed).sample(range(len(mutants)), max(1, round(share * len(mutants))))
    return [mutants[row] for row in sorted(rows)]


def _try_all(target: Target, mutants: Sequence[Mutant]) -> list[Tried]:
    import_all_but(target.path)
    seconds, began = baseline_s(target.tests), time.monotonic()
    print(
        f"{target.path}: {len(mutants)} mutants, the tests take {seconds:.1f} s of processor time", flush=True
    )
    reasons = read_reasons(target.path)
    tried: list[Tried] = []
    for mutant in mutants:
        if tried and len(tried) % PROGRESS_EVERY == 0:
            print(f"  {len(tried)} tried", flush=True)
        tried.append(try_mutant(target.path, mutant, target.tests, seconds))
        if tried[-1].outcome != "killed":
            known = reasons.get(key_of(mutant))
            said = "" if known is None else f" (equivalent: {known})"
            print(f"  {tried[-1].outcome} {target.path}:{mutant}{said}", flush=True)
    print(f"  {summary_of(tried, reasons)} {(time.monotonic() - began) / 60:.1f} min", flush=True)
    return tried


if __name__ == "__main__":
    main()
