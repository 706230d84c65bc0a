"""A scan examined before it is built, and read another way where the options ask for repair."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from app.engine.mapping.examination.consistency import DRIFT
from app.engine.mapping.examination.examine import examine_scan
from app.engine.mapping.examination.outcome import Examination, Finding, RefusedScanError
from app.engine.mapping.loops.close import ClosedLoops, close_loops
from app.engine.mapping.options import BuildOptions, parse_build_options
from app.engine.mapping.structure.estimate import EstimatedScan, estimate_poses
from app.engine.progress import Progress
from app.errors import InvalidScanError
from app.importers.frames import Scan, ScanOptions
from app.importers.registry import open_scan, open_unposed
from app.importers.unposed.scan import UnposedScan
from app.services.resources import Resources

WITHOUT_SCALE = "A map without scale can't be extended, nor can a scan without scale extend one: give scale."
# One mistake hides another, as wrong axes hide a wrong depth scale.
MAX_REPAIRS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class ExaminedScan:
    """A scan that may be built, the options that it was read with, and what its examination found.

    `repairs` are the findings that `repair` mended. A scan whose poses are a stated motion is not examined, since they
    are no measurement, nor is one whose poses were estimated from its own pictures, by `estimate`.
    """

    scan: Scan
    options: BuildOptions
    examination: Examination | None
    repairs: tuple[Finding, ...] = ()
    estimate: EstimatedScan | None = None
    loops: ClosedLoops | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is doubtful about the scan."""
        estimated = () if self.estimate is None else self.estimate.warnings
        examined = estimated if self.examination is None else self.examination.warnings
        return examined if self.loops is None else (*examined, *self.loops.warnings)

    def repairs_report(self) -> dict[str, Any]:
        """Return the first lines of the build's report, none where nothing was repaired or estimated."""
        if self.estimate is not None:
            return {"structure": self.estimate.report}
        loops = {} if self.loops is None else {"loops": self.loops.as_dict()}
        if not self.repairs:
            return loops
        changed = {name: value for finding in self.repairs for name, value in finding.options.items()}
        told = " ".join(finding.sentence for finding in self.repairs)
        return {
            "repaired": f"The scan was read another way than its files and options say. {told}",
            "repairs": changed,
            **loops,
        }


def read_scan(
    root: Path,
    options: Mapping[str, Any],
    resources: Resources,
    progress: Progress,
    *,
    up_is_known: bool,
    scratch: Path,
) -> ExaminedScan:
    """Return the scan of a folder, read with the options of a request: examined, or with estimated poses.

    `up_is_known` and `scratch` are as in `examined_scan`, which raises the same.
    """
    parsed = parse_build_options(options)
    given = replace(parsed.scan, scratch=scratch)
    unposed = unposed_scan(root, parsed, given)
    if unposed is not None:
        estimate = estimate_poses(unposed, parsed.scale, resources.models, resources.executor, progress)
        return ExaminedScan(scan=estimate.scan, options=parsed, examination=None, estimate=estimate)
    scan = open_scan(root, parsed.format, given)
    return examined_scan(
        root,
        scan,
        options,
        resources.executor,
        progress,
        up_is_known=up_is_known,
        scratch=scratch,
        close=partial(close_loops, models=resources.models, executor=resources.executor, progress=progress),
    )


def unposed_scan(root: Path, options: BuildOptions, given: ScanOptions) -> UnposedScan | None:
    """Return the pictures of a folder whose poses a build would estimate, None for a scan with poses.

    Raises `InvalidScanError` as `open_unposed`, and where the options don't fit: a `scale` beside poses, or none for a
    map that is extended.
    """
    unposed = open_unposed(root, options.format, given)
    if unposed is None:
        if options.scale is None:
            return None
        raise InvalidScanError(
            'The option scale is for pictures without poses, and this scan has poses: leave it out, or give "poses": '
            '"estimate" to have them estimated from the pictures.'
        )
    lacks_scale = options.scale is None and not (unposed.listed and unposed.listed.has_depth)
    if options.mode == "extend" and lacks_scale:
        raise InvalidScanError(WITHOUT_SCALE)
    return unposed


def examined_scan(
    root: Path,
    scan: Scan,
    options: Mapping[str, Any],
    executor: Executor,
    progress: Progress,
    *,
    up_is_known: bool = False,
    scratch: Path | None = None,
    close: Callable[[Scan], ClosedLoops] | None = None,
) -> ExaminedScan:
    """Examine the scan of a folder, read with the options of a request; `scratch` is as in `ScanOptions`.

    With `repair` the options of a remedy that is beyond doubt are added and the scan is read and examined again. With
    `close` a scan of which nothing but drift is wrong has its loops closed, and is examined again when that corrected
    it. Raises `RefusedScanError` for a scan that is refused, with what was found and the option that would mend it.
    """
    values = dict(options)
    parsed = parse_build_options(values)
    repairs: list[Finding] = []
    closed: ClosedLoops | None = None
    while True:
        if parsed.scan.motion is not None:
            return ExaminedScan(scan=scan, options=parsed, examination=None)
        found = examine_scan(
            scan,
            parsed.scan,
            parsed.gravity or scan.gravity,
            executor,
            progress,
            up_is_known=up_is_known or parsed.world_from_scan is not None,
        )
        if close is not None and closed is None and all(one.code == DRIFT for one in found.wrong):
            closed = close(scan)
            scan = closed.scan
            if closed.is_applied and any(one.code == DRIFT for one in found.findings):
                continue
        if found.verdict != "refused":
            return ExaminedScan(
                scan=scan, options=parsed, examination=found, repairs=tuple(repairs), loops=closed
            )
        if not parsed.repair or found.remedy is None or len(repairs) >= MAX_REPAIRS:
            raise RefusedScanError(found)
        repairs.extend(found.wrong)
        values.update(found.remedy)
        parsed = parse_build_options(values)
        scan, closed = open_scan(root, parsed.format, replace(parsed.scan, scratch=scratch)), None
