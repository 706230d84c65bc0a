"""How a tracker without a map begins: by two fixes of one place, and not while two places are seen."""

from __future__ import annotations

from dataclasses import replace

from app.engine.anchors.anchor import ANYWHERE, AnchorSearch
from app.engine.anchors.locator import AnchorLocalization
from app.engine.floors.collection import read_collection
from app.engine.floors.floor import Floor
from app.engine.query.placed import Accuracy
from app.engine.tracking.anchor_fixes import AnchorFixes
from app.engine.tracking.fix import Fix, NoFix
from app.engine.tracking.frame import TrackingFrame
from app.engine.tracking.plan_walk.plan_tracker import PlanTracker
from app.engine.tracking.plan_walk.plans import Plans
from app.engine.tracking.surroundings import Surroundings
from app.engine.tracking.tracked import Tracked
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from tests.given_fixes import BLANK, PLAN, Seen, fix_at
from tests.plans import GROUND
from tests.scenes import CAMERA

FLOOR = Floor(
    venue_id="v", id="ground", name="Ground", level=0, z_min_m=-1, z_max_m=3, plan_from_world=None,
    plan_residual_m=None, plan=None, features_sha256=None,
)  # fmt: skip
PLANS = Plans.of([FLOOR], {"ground": read_collection(GROUND, "ground")[1]})
OFFICE = replace(fix_at(9.0, 4.0, frame_id=PLAN), accuracy=Accuracy(0.2, 2.0))
NOTHING = NoFix("no_match")
TWO_PLACES = NoFix("ambiguous", is_contested=True)


class Told(AnchorFixes):
    """Anchors that see what a test says, and keep what they were asked."""

    def __init__(self) -> None:
        super().__init__(lambda *_: AnchorLocalization(), [FLOOR])
        self.seen: Fix | NoFix = NOTHING
        self.searches: list[AnchorSearch] = []

    def locate(
        self,
        frame: TrackingFrame,
        camera: Camera | None,
        _near: Pose | None,
        _any_floor: bool = False,
        search: AnchorSearch = ANYWHERE,
    ) -> Fix | NoFix:
        self.searches.append(search)
        return self.seen


class Walk:
    """A tracker whose anchors are asked at each look."""

    def __init__(self) -> None:
        self.anchors = Told()
        self.tracker = PlanTracker()
        self.frames = 0

    def look(self, seen: Fix | NoFix) -> Tracked:
        """Return the answer to the next frame in which anchors are asked."""
        self.anchors.seen = seen
        surroundings = Surroundings(Seen(), plans=PLANS, anchors=self.anchors)
        asked = len(self.anchors.searches)
        while len(self.anchors.searches) == asked:
            frame = TrackingFrame.of(BLANK, 0.05 * self.frames, camera=CAMERA)
            answer = self.tracker.process(frame, surroundings)
            self.frames += 1
        return answer


def test_a_first_fix_waits_for_a_second_one() -> None:
    walk = Walk()
    assert walk.look(OFFICE).placed is None
    assert walk.look(NOTHING).placed is None
    assert walk.look(OFFICE).state == "tracking"


def test_a_first_fix_is_forgotten_where_two_places_are_seen() -> None:
    walk = Walk()
    walk.look(OFFICE)
    assert walk.look(TWO_PLACES).placed is None
    assert walk.look(OFFICE).placed is None
    assert walk.look(OFFICE).state == "tracking"


def test_a_place_that_is_known_is_not_forgotten_for_a_look_alike() -> None:
    walk = Walk()
    walk.look(OFFICE)
    walk.look(OFFICE)
    assert walk.look(TWO_PLACES).placed is not None


def test_rough_fixes_are_asked_for_until_the_place_is_known_and_then_around_it() -> None:
    walk = Walk()
    walk.look(OFFICE)
    walk.look(OFFICE)
    walk.look(OFFICE)
    first, second, third = walk.anchors.searches
    assert first == second == AnchorSearch(to_be_confirmed=True)
    assert not third.to_be_confirmed
    assert third.around is not None
    assert third.may_be_rough


def by(name: str, x: float = 9.0, sigma_m: float = 0.2) -> Fix:
    """Return a fix by one camera, somewhere in the office."""
    fix = replace(fix_at(x, 4.0, frame_id=PLAN), accuracy=Accuracy(sigma_m, 2.0))
    return replace(fix, anchors=(name,))


def sigma_m(answer: Tracked) -> float:
    """Return the stated accuracy of an answer."""
    assert answer.accuracy is not None
    return answer.accuracy.position_m


def test_many_pictures_of_one_camera_make_the_place_no_surer_than_one() -> None:
    again, anew = Walk(), Walk()
    for walk in (again, anew):
        walk.look(by("hall", sigma_m=0.8))
        walk.look(by("hall", sigma_m=0.8))
    for number in range(4):
        same = again.look(by("hall", sigma_m=0.8))
        other = anew.look(by(f"camera-{number}", sigma_m=0.8))
    assert sigma_m(same) > 0.7
    assert sigma_m(other) < 0.5


def test_a_place_that_got_less_sure_is_corrected_by_the_same_camera() -> None:
    walk = Walk()
    walk.look(by("hall", sigma_m=0.4))
    walk.look(by("hall", sigma_m=0.4))
    assert sigma_m(walk.look(by("hall", sigma_m=0.1))) < 0.2
