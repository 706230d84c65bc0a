"""What the steps of a build are given, and what they report."""

from __future__ import annotations

import io
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from app.engine.progress import NoProgress
from app.errors import MapDamagedError
from app.services.builds import run_build as module
from app.services.builds.run_build import MadeMap, linked_scan, make_map, scratch, unpack
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.services.submit_build import submit_build
from app.storage.builds import get_build
from app.storage.floors import put_floor
from app.storage.maps import get_map
from tests.made_map import (
    OPTIONS,
    Inline,
    Noted,
    Prepared,
    claimed,
    extending,
)
from tests.scenes import zipped


@dataclass
class Steps:
    """Stands in for the parts of a build that take time: returns what they made of the scan."""

    made: MadeMap
    up_is_known: list[bool]

    def put_in(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(module, "read_scan", self._read_scan)
        monkeypatch.setattr(module, "place_scan", lambda *_: self.made.placement)
        monkeypatch.setattr(module, "build_map", lambda *_: self.made.built)
        monkeypatch.setattr(module, "check_map", lambda *_: self.made.check)

    def _read_scan(self, *_: object, up_is_known: bool, scratch: Path) -> object:
        assert scratch.is_dir()
        self.up_is_known.append(up_is_known)
        return self.made.examined


@pytest.fixture
def steps(made: MadeMap, monkeypatch: pytest.MonkeyPatch) -> Steps:
    found = Steps(made, [])
    found.put_in(monkeypatch)
    return found


def test_a_scan_is_unpacked_unless_another_worker_has_done_so(
    steps: Steps, resources: Resources, prepared: Prepared, tmp_path: Path
) -> None:
    build = claimed(resources)
    for root, unpacks in ((None, True), (prepared.root, False)):
        progress = Noted()
        folder = tmp_path / f"scratch-{unpacks}"
        folder.mkdir()
        found = make_map(build, resources, MapLibrary(resources), progress, folder, root)
        assert found.built is steps.made.built
        assert (progress.reports[0][0] == "unpack") == unpacks == (folder / module.UNPACKED).exists()
        assert progress.reports[-1] == ("read", 0, 1)
        assert {stage for stage, *_ in progress.reports} <= {"unpack", "read"}
    assert steps.up_is_known == [False, False]


def test_the_seconds_of_each_stage_are_the_clocks(
    steps: Steps,
    publish: Callable[..., dict[str, Any]],
    resources: Resources,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    def clock(*times: float) -> None:
        monkeypatch.setattr(module, "time", SimpleNamespace(perf_counter=iter(times).__next__))

    library = MapLibrary(resources)
    with resources.database.read() as connection:
        build = get_build(connection, str(connection.exec_driver_sql("select id from builds").scalar()))
    clock(10.0, 11.23456, 14.35802, 19.70370, 30.0, 36.78912)
    found = make_map(build, resources, library, NoProgress(), tmp_path)
    built = steps.made.built.seconds
    assert found.seconds == {"unpack": 1.235, "examine": 3.123, "place": 5.346, **built, "verify": 6.789}
    clock(100.0, 107.65432)
    assert publish(found)["seconds"] == {**found.seconds, "store": 7.654}


@pytest.mark.parametrize("z_is_up", [None, False, True], ids=str)
def test_what_results_depend_on_is_stated_before_they_are_made(
    steps: Steps,
    publish: Callable[..., dict[str, Any]],
    resources: Resources,
    tmp_path: Path,
    z_is_up: bool | None,
) -> None:
    if z_is_up is not None:
        publish(replace(steps.made, placement=replace(steps.made.placement, z_up=z_is_up)))
        submit_build(resources, "v", OPTIONS, io.BytesIO(zipped({"rgb.txt": b"#"})))
    with resources.database.write() as connection:
        for floor, plan in (("ground", np.eye(4)), ("roof", None)):
            put_floor(
                connection,
                "v",
                floor,
                name="",
                level=0,
                z_min_m=0.0,
                z_max_m=3.0,
                plan_from_world=plan,
                plan_residual_m=None,
            )
    together = replace(resources, executor=Inline())
    make_map(claimed(resources), together, MapLibrary(resources), NoProgress(), tmp_path, tmp_path)
    assert steps.up_is_known == [bool(z_is_up)]
    placement = steps.made.placement
    assert isinstance(together.executor, Inline)
    first, *present, last = together.executor.stated
    assert first[1] == resources.models.global_descriptor.sha256
    assert last == (placement.world_from_scan.matrix.tobytes(), placement.z_up)
    if z_is_up is None:
        assert present == []
    else:
        with resources.database.read() as connection:
            version = get_map(connection, "v", 1)
        assert present == [(version.artifact_blob, ("ground",))]


def test_a_damaged_map_is_replaced_by_what_fits_the_one_before_and_not_extended(
    publish: Callable[..., dict[str, Any]], resources: Resources, made: MadeMap
) -> None:
    build, library = claimed(resources, "other"), MapLibrary(resources)
    options = made.examined.options
    assert module._present_map(build, options, library, resources) is None
    publish(queued=False)
    publish(extending(made, resources), queued=False)
    found = module._present_map(build, options, MapLibrary(resources), resources)
    assert found is not None
    assert (found.version.version, found.placed_floors) == (2, ())
    resources.blobs.local_path(found.version.artifact_blob).write_bytes(b"damaged" * 99)
    before = module._present_map(build, options, MapLibrary(resources), resources)
    assert before is not None
    assert before.version.version == 1
    with pytest.raises(MapDamagedError):
        module._present_map(build, replace(options, mode="extend"), MapLibrary(resources), resources)
    resources.blobs.local_path(before.version.artifact_blob).write_bytes(b"damaged" * 99)
    assert module._present_map(build, options, MapLibrary(resources), resources) is None


def test_a_scratch_folder_is_empty_at_first_and_gone_in_the_end(tmp_path: Path) -> None:
    folder = tmp_path / "of" / "a build"
    for leaves in (True, False):
        with scratch(folder) as found:
            assert list(found.iterdir()) == []
            (found / "file").write_text("")
            if not leaves:
                shutil.rmtree(found)
        assert not folder.exists()
    folder.mkdir()
    (folder / "left by a killed worker").write_text("")
    with scratch(folder) as found:
        assert list(found.iterdir()) == []


def test_an_unpacked_scan_is_linked_by_another_worker_once_it_is_whole(
    resources: Resources, tmp_path: Path
) -> None:
    own, other = tmp_path / "own", tmp_path / "other"
    own.mkdir()
    assert linked_scan(own, other) is None
    progress = Noted()
    root = unpack(claimed(resources), resources, own, progress)
    assert {stage for stage, *_ in progress.reports} == {"unpack"}
    assert progress.reports[-1][1] == progress.reports[-1][2] > 0
    found = linked_scan(own, other)
    assert found == other / root.relative_to(own)
    names = sorted(path.relative_to(root) for path in root.rglob("*.png"))
    assert len(names) == 8
    assert all((root / name).samefile(found / name) for name in names)
    assert not (own / f"{module.UNPACKED}.part").exists()
