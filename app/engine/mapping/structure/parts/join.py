"""The parts of a path that are joined to one by links, checked against each other and by the time between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.engine.mapping.structure.matches import MatchedPictures
from app.engine.mapping.structure.parts.links import OPTIONS as LINKS
from app.engine.mapping.structure.parts.links import Link, agrees, find_links
from app.engine.mapping.structure.parts.localized import PartPoints, partners_of
from app.engine.mapping.structure.parts.pace import is_walk
from app.engine.mapping.structure.parts.similarity import Similarity
from app.engine.mapping.structure.reconstruction import Reconstruction
from app.engine.progress import Progress
from app.geometry.se3 import Pose


@dataclass(slots=True)
class Group:
    """Parts by their rows in a list, and how each lies in the group."""

    group_from_part: dict[int, Similarity]

    def poses(self, parts: Sequence[PartPoints]) -> dict[int, Pose]:
        """Return the pose of each picture in the group, that of its largest part."""
        return {
            row: self.group_from_part[number].move(pose)
            for number in sorted(self.group_from_part, reverse=True)
            for row, pose in parts[number].part.poses.items()
        }


def join_parts(
    parts: Sequence[Reconstruction], matched: MatchedPictures, times_s: Sequence[float], progress: Progress
) -> list[tuple[Reconstruction, int]]:
    """Return the parts, the largest first, with those joined that links tie together, and of how many each is made.

    `times_s` are the times of all pictures. The best supported links come first (as in Kruskal's algorithm). One is
    left out where others between the same groups of parts contradict it, or where the path would leap at a seam.
    """
    ordered = [PartPoints.of(part, matched) for part in sorted(parts, key=lambda part: -len(part.poses))]
    links = find_links(ordered, matched, partners_of(matched.matches), progress)
    group_of = {number: Group({number: Similarity.identity()}) for number in range(len(ordered))}
    for link in sorted(links, key=lambda link: -len(link.ties)):
        a, b = group_of[link.a], group_of[link.b]
        if a is b:
            continue
        b_from_a = b.group_from_part[link.b] @ link.b_from_a @ a.group_from_part[link.a].inverse()
        others = [other for other in links if _connects(other, a, b)]
        if not _is_confirmed(b_from_a, link, a, b, others, ordered):
            continue
        moved = {row: b_from_a.move(pose) for row, pose in a.poses(ordered).items()}
        depth = b.group_from_part[link.b].scale * ordered[link.b].median_depth
        if not is_walk(moved, b.poses(ordered), times_s, depth):
            continue
        for number, own in a.group_from_part.items():
            b.group_from_part[number] = b_from_a @ own
            group_of[number] = b
    groups = list({id(group): group for group in group_of.values()}.values())
    joined = [(merged(group, ordered), len(group.group_from_part)) for group in groups]
    return sorted(joined, key=lambda each: -len(each[0].poses))


def merged(group: Group, parts: Sequence[PartPoints]) -> Reconstruction:
    """Return one reconstruction of a group's parts; a picture of several is that of the largest, with its points."""
    first, *others = sorted(group.group_from_part)
    if not others and group.group_from_part[first].scale == 1.0:
        return parts[first].part
    poses: dict[int, Pose] = {}
    points, observations = [], []
    count = 0
    for number in (first, *others):
        own, part = group.group_from_part[number], parts[number].part
        new = [row for row in part.poses if row not in poses]
        seen = part.observations[np.isin(part.observations[:, 0], new)]
        poses.update((row, own.move(part.poses[row])) for row in new)
        points.append(own.apply(part.points))
        observations.append(seen + np.array([0, 0, count]))
        count += len(part.points)
    return Reconstruction(
        camera=parts[first].part.camera,
        poses=dict(sorted(poses.items())),
        points=np.concatenate(points),
        observations=np.concatenate(observations),
        error_px=max(parts[number].part.error_px for number in group.group_from_part),
    )


def _is_confirmed(
    b_from_a: Similarity, link: Link, a: Group, b: Group, links: Sequence[Link], parts: Sequence[PartPoints]
) -> bool:
    """Return whether most pictures of all links between two groups agree with how a link puts one into the other."""
    middle = np.median([b.group_from_part[link.b].move(tie.in_b).translation for tie in link.ties], axis=0)
    votes = []
    for other in links:
        own_a, own_b, ties = (other.a, other.b, other.ties)
        if own_a not in a.group_from_part:
            own_a, own_b, ties = own_b, own_a, tuple(tie.turned() for tie in ties)
        expected = b.group_from_part[own_b].inverse() @ b_from_a @ a.group_from_part[own_a]
        near = Pose(np.eye(3), b.group_from_part[own_b].inverse().apply(middle))
        votes += [agrees(expected, near, tie, parts[own_b].median_depth) for tie in ties]
    return bool(np.mean(votes) >= LINKS.min_agreeing_share)


def _connects(link: Link, a: Group, b: Group) -> bool:
    ends = [{link.a in group.group_from_part, link.b in group.group_from_part} for group in (a, b)]
    return all(each == {True, False} for each in ends)
