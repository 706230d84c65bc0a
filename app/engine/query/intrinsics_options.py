"""When a stated camera is doubted, when another one is used in its place, and what either is worth."""

from __future__ import annotations

from dataclasses import dataclass

from app.limits import limit

ON_ZOOMED = (
    "roomfix evaluate-cameras on RedKitchen, desk_rs and freiburg1_rpy; docs/figures/evaluate-cameras.md."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class IntrinsicsCheckOptions:
    """When a stated camera is doubted, and when another one is used in its place."""

    min_features: int = limit(
        12, "Fewest inliers that a camera is checked with.", chosen="By hand: nine unknowns need five points."
    )
    doubt_log: float = limit(
        0.025, "Change of the focal length's logarithm from which on a camera is doubted.", chosen=ON_ZOOMED
    )
    doubt_offset_share: float = limit(
        0.04,
        "Offset of the principal point, over the image's longer side, that is doubted.",
        chosen=ON_ZOOMED,
    )
    doubt_sigmas: float = limit(2.0, "Sigmas by which a change must differ from none.", chosen=ON_ZOOMED)
    sure_doubt_log: float = limit(
        0.015, "As doubt_log, where the change is beyond sure_doubt_sigmas.", chosen=ON_ZOOMED
    )
    sure_doubt_sigmas: float = limit(
        3.0, "Sigmas by which a smaller change must differ from none.", chosen=ON_ZOOMED
    )
    unverified_sigma: float = limit(
        0.05,
        "Relative sigma of the focal length by the matches above which they don't verify a camera at all.",
        chosen=ON_ZOOMED,
    )
    min_depth_spread: float = limit(
        0.13,
        "Spread of the inliers' depths (1.4826 times the median absolute deviation, over the median) below which they "
        "don't verify a camera: of a flat scene, a longer focal length shows the same as a nearer place.",
        chosen=ON_ZOOMED,
    )
    flat_sigma: float = limit(
        0.012,
        "Relative sigma of the focal length by matches of a flat scene up to which they verify a camera all the same.",
        chosen="By hand, on the scenes of evaluate-cameras and the demonstration's wing: the wrong cameras that a flat "
        "scene leaves open have 0.015 or more, many right ones less.",
    )
    flat_log: float = limit(
        0.008,
        "Change of the focal length's logarithm up to which they do.",
        chosen="By hand, as flat_sigma: 0.009 or more for the wrong ones.",
    )
    max_refined_log: float = limit(
        0.92,
        "Largest change of the focal length's logarithm that refining may make; where it would go on, nothing is "
        "answered.",
        chosen="By hand: a factor of 2.5, beyond any zoom of a picture that still shows its room. Of flat scenes a "
        "longer focal length from farther away shows the same.",
    )
    rounds: int = limit(4, "Most rounds of refining a doubted camera.", chosen=ON_ZOOMED)
    rough_rounds: int = limit(
        12,
        "The same from a focal length that is only near the right one.",
        chosen="By hand: the inliers of a camera favour it, so that each round mends only a part of a large zoom; of "
        "freiburg1_rpy at zoom 2 the focal length still grew after 4.",
    )
    search_log: float = limit(
        0.12,
        "Change of the focal length's logarithm from which on all focal lengths are searched.",
        chosen=ON_ZOOMED,
    )
    min_gain_ratio: float = limit(
        1.12,
        "Inliers with the refined camera, over those with the stated one, from which on it is used.",
        chosen=ON_ZOOMED,
    )
    confirmed_sigma: float = limit(
        0.01,
        "Relative sigma of the focal length by the matches up to which they confirm a camera.",
        chosen=ON_ZOOMED,
    )
    confirmed_log: float = limit(
        0.005,
        "Change of the focal length's logarithm up to which matches confirm a camera: inliers of the stated one show "
        "only part of what another camera would change.",
        chosen=ON_ZOOMED,
    )
    round_gain_ratio: float = limit(
        1.02,
        "Inliers after a round of refining, over those before, up to which refining ends.",
        chosen="By hand: a free camera fits the map's errors too, and moves away from the right one.",
    )
    round_gain_share: float = limit(
        0.001,
        "Cost that a round from a focal length that is only near the right one must save, over its inliers.",
        chosen="By hand: rounds that only go back and forth end; with a hundredth zooms of 1.5 ended up to 53 cm off.",
    )
    simpler_share: float = limit(
        0.05,
        "Cost by which a camera of fewer unknowns may exceed the least one, over its inliers, and still be preferred.",
        chosen="By hand: a twentieth of what an outlier costs; unknowns always lower the cost a little.",
    )
    centred_share: float = limit(
        0.15,
        "The same for a camera that keeps the stated principal point.",
        chosen=ON_ZOOMED,
    )
    sure_gain_ratio: float = limit(
        1.04,
        "As min_gain_ratio, where the change of the focal length is beyond sure_sigmas.",
        chosen=ON_ZOOMED,
    )
    sure_sigmas: float = limit(
        4.0, "Sigmas of the focal length beyond which a smaller gain is enough.", chosen=ON_ZOOMED
    )
    screened_share: float = limit(
        0.5,
        "Inliers over matches below which other zooms are tried: the inliers of a wrong camera can agree among each "
        "other, but are few.",
        chosen="By hand: half the matches of right cameras agree on ordinary pictures.",
    )
    max_refined_offset_ratio: float = limit(
        0.2,
        "Largest change of the principal point of a refined camera, relative to the image's size; with a larger one "
        "nothing is answered.",
        chosen="By hand: a cut image moves it by less where its numbers are taken at all; of stretched pictures of the "
        "tests' rooms it moved by 0.24 and 0.34, and their poses were 23 and 29 degrees off.",
    )
    max_disputed_log: float = limit(
        0.2,
        "Largest change of the focal length's logarithm to a zoom that more matches agree with, while no camera is "
        "found that they agree with well; with a larger one nothing is answered.",
        chosen=ON_ZOOMED,
    )
    sigma_factor: float = limit(
        1.75,
        "Factor on the focal length's sigma by the matches: it is the sigma of inliers of the stated camera, which are "
        "those that agree with it.",
        chosen=ON_ZOOMED,
    )
    truncation_factor: float = limit(
        1.5,
        "Factor on the change that another camera would make: it is estimated on inliers of the stated one, which "
        "leaves out what contradicts it most.",
        chosen=ON_ZOOMED,
    )
    unsure_confidence: float = limit(
        0.89,
        "Largest confidence of an answer whose stated camera its matches contradict without showing another one, or "
        "leave open where fewer than sure_inlier_ratio agree, or whose accuracy by another camera is too poor.",
        chosen="By hand: below 0.9, where an answer counts as sure; such a camera may be off by more than is stated.",
    )
    sure_inlier_ratio: float = limit(
        0.6,
        "Inliers over matches from which on an answer may be sure though its camera is open, and from which on only "
        "cameras within simpler_share of the least cost say how uncertain the position by a refined one is.",
        chosen=ON_ZOOMED,
    )
    max_sure_sigma_m: float = limit(
        0.5,
        "Largest standard deviation of the position of an answer that may be sure though its camera is not confirmed.",
        chosen="By hand: a confidence is for an error below half a metre, which every third error of this one exceeds.",
    )
    max_sure_sigma_deg: float = limit(
        3.5,
        "The same of the orientation.",
        chosen="roomfix evaluate-cameras on RedKitchen and freiburg1_rpy: of 763 refined answers below it none is off "
        "by 5 degrees, of 115 above it one is.",
    )
    open_sigma: float = limit(
        0.02,
        "Least relative standard deviation of a stated focal length that the matches leave open or contradict, or "
        "confirm by a flat scene alone.",
        chosen="By hand: calibrations of phones differ by 1 to 2 % from picture to picture, as focus moves the lens.",
    )
    unseen_sigma: float = limit(
        0.07,
        "Relative standard deviation of a stated focal length that the matches leave open, as the accuracy states it.",
        chosen="By hand: a third of what a zoom of 1.25 moves a pose by, the largest that matches which mostly agree "
        "have not shown.",
    )
    refined_sigma: float = limit(
        0.12,
        "Relative standard deviation of a focal length that was refined by refined_features inliers or more: the "
        "errors of the map's points are common to all.",
        chosen=ON_ZOOMED,
    )
    fitted_sigma: float = limit(
        0.04,
        "Relative standard deviation of a focal length that was not stated and fitted to the matches, beyond what "
        "their own noise makes of it: the errors of the map's points are common to all.",
        chosen="roomfix evaluate --no-camera on freiburg1_rpy; docs/figures/reliability.md.",
    )
    moved_centre_factor: float = limit(
        0.5,
        "Standard deviation of the orientation by a refined camera, over the angle by which its principal point moved.",
        chosen="By hand: three right cameras of freiburg1_rpy were turned by 7 degrees, all wrongly; of pictures "
        "that are cut aside the angle is right.",
    )
    centre_sigma_share: float = limit(
        0.025,
        "Standard deviation of a principal point that was not stated or belongs to a refined camera, over the image's "
        "longer side.",
        chosen="By hand: calibrated cameras have theirs 1 to 3 % from the middle.",
    )
    refined_features: int = limit(
        100,
        "Inliers below which that standard deviation grows with the inverse of the root of their number.",
        chosen=ON_ZOOMED,
    )


OPTIONS = IntrinsicsCheckOptions()
