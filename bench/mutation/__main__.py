"""`python -m bench.mutation`: which small changes to the code that refuses wrong answers no test notices."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

from bench.mutation.mutants import mutants_of
from bench.mutation.report import Result, page_of, read_reasons
from bench.mutation.run import baseline_s, import_libraries, try_mutant
from bench.mutation.targets import TARGETS, Target

RESULTS = Path(".mutants.json")
PAGE = Path("docs/figures/mutants.md")


def main() -> None:
    """Try the mutants of the modules that are named, or of all; print each one that survives."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modules", nargs="*", help="parts of the modules' paths; all without")
    parser.add_argument("--function", help="only the mutants of functions with this in their name")
    parser.add_argument("--write", action="store_true", help=f"write {PAGE} from all results that are kept")
    options = parser.parse_args()
    import_libraries()
    results = _kept()
    for target in TARGETS:
        if not options.modules or any(part in target.path for part in options.modules):
            found = _run(target, options.function)
            if options.function is None:
                results[target.path] = found
                RESULTS.write_text(json.dumps({path: each.as_dict() for path, each in results.items()}))
    if options.write:
        PAGE.parent.mkdir(parents=True, exist_ok=True)
        PAGE.write_text(page_of([results[each.path] for each in TARGETS if each.path in results]))


def _kept() -> dict[str, Result]:
    if not RESULTS.exists():
        return {}
    return {path: Result.from_dict(values) for path, values in json.loads(RESULTS.read_text()).items()}


def _run(target: Target, function: str | None) -> Result:
    mutants = [
        mutant
        for mutant in mutants_of(Path(target.path).read_text(encoding="utf-8"))
        if (not target.functions or mutant.function in target.functions)
        and (function is None or function in mutant.function)
    ]
    seconds = baseline_s(target.tests)
    print(
        f"{target.path}: {len(mutants)} mutants, the tests take {seconds:.1f} s of processor time", flush=True
    )
    began = time.monotonic()
    reasons = read_reasons(target.path)
    tried = []
    for mutant in mutants:
        tried.append(try_mutant(target.path, mutant, target.tests, seconds))
        if tried[-1].outcome != "killed":
            known = reasons.get((mutant.function, mutant.before, mutant.after))
            said = "" if known is None else f" (equivalent: {known})"
            print(f"  {tried[-1].outcome} {target.path}:{mutant}{said}", flush=True)
    result = Result.of(target.path, tried)
    minutes = (time.monotonic() - began) / 60
    print(f"  {result.killed} of {result.mutants} killed in {minutes:.1f} min", flush=True)
    return result


if __name__ == "__main__":
    main()
