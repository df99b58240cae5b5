"""Rigid transforms: where one frame is in another, composed over a chain of frames.

A transform is a translation (3,) [m] and a unit quaternion (4,), x, y, z, w: the pose of the child
in its parent. The names of frames make a tree, in which each child has one parent.

References
----------
.. [1] K. Shoemake, "Animating rotation with quaternion curves", SIGGRAPH 1985: slerp.
.. [2] T. Foote, "tf: The transform library", TePRA 2013: the latest time at which a chain is known.
"""

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from bo_tuner.numerics.arrays import Array

KEPT = 10_000_000_000
"""Time [ns] for which transforms are kept, to be composed with others of that time."""
STILL = None
"""Stamp of a transform that does not change."""


@dataclass(frozen=True)
class Transform:
    """The pose of a frame in another one: translation (3,) [m] and rotation (4,) x, y, z, w."""

    translation: Array
    rotation: Array

    def __matmul__(self, other: "Transform") -> "Transform":
        """Return the pose of the frame that `other` places in this one's child."""
        return Transform(
            self.translation + rotated(self.rotation, other.translation),
            product(self.rotation, other.rotation),
        )

    @property
    def inverse(self) -> "Transform":
        """The pose of the parent in the child."""
        back = self.rotation * (-1.0, -1.0, -1.0, 1.0)
        return Transform(-rotated(back, self.translation), back)


IDENTITY = Transform(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))


def normalized(rotation: Array) -> Array:
    """Return a quaternion (4,) with the length 1; NaN if it has none."""
    length = float(np.linalg.norm(rotation))
    return rotation / length if length > 0.0 else np.full(4, np.nan)


def product(one: Array, other: Array) -> Array:
    """Return the rotation (4,) by `other` and then by `one`."""
    x, y, z, w = one
    a, b, c, d = other
    return np.array(
        [
            w * a + x * d + y * c - z * b,
            w * b - x * c + y * d + z * a,
            w * c + x * b - y * a + z * d,
            w * d - x * a - y * b - z * c,
        ]
    )


def rotated(rotation: Array, vector: Array) -> Array:
    """Return a vector (3,) rotated by a unit quaternion (4,)."""
    axis, w = rotation[:3], rotation[3]
    twice = 2.0 * np.cross(axis, vector)
    return np.asarray(vector + w * twice + np.cross(axis, twice))


def interpolated(begin: Transform, end: Transform, share: float) -> Transform:
    """Return what lies between two transforms: straight, and of rotations by slerp [1]_.

    Parameters
    ----------
    begin, end
        The transforms.
    share
        0 at `begin`, 1 at `end`.
    """
    translation = (1.0 - share) * begin.translation + share * end.translation
    cosine = float(begin.rotation @ end.rotation)
    # Of the two ways around the shorter one.
    other = end.rotation if cosine >= 0.0 else -end.rotation
    angle = float(np.arccos(min(abs(cosine), 1.0)))
    if angle < 1e-6:
        return Transform(translation, normalized((1.0 - share) * begin.rotation + share * other))
    weights = np.sin([(1.0 - share) * angle, share * angle]) / np.sin(angle)
    return Transform(translation, weights[0] * begin.rotation + weights[1] * other)


@dataclass
class _Link:
    """The pose of a frame in its parent, over time; one that stands still has no stamps."""

    parent: str
    stamps: list[int] = field(default_factory=list)
    poses: list[Transform] = field(default_factory=list)
    publishers: set[str] = field(default_factory=set)

    def add(self, stamp: int | None, pose: Transform) -> None:
        if stamp is STILL:
            self.stamps.clear()
            self.poses[:] = [pose]
            return
        # Later stamps are void: the time went back, as in a simulation that was reset.
        keep = 0 if not self.stamps else bisect_right(self.stamps, stamp - 1)
        del self.stamps[keep:], self.poses[keep:]
        self.stamps.append(stamp)
        self.poses.append(pose)
        if stamp - self.stamps[0] > 2 * KEPT:
            old = bisect_right(self.stamps, stamp - KEPT)
            del self.stamps[:old], self.poses[:old]

    def at(self, stamp: int) -> Transform | None:
        """Return the pose at a time [ns]; None before the first one."""
        if not self.stamps:
            return self.poses[0]
        k = bisect_right(self.stamps, stamp)
        if k == 0:
            return None
        if k == len(self.stamps) or self.stamps[k - 1] == stamp:
            return self.poses[k - 1]
        begin, end = self.stamps[k - 1 : k + 1]
        share = (stamp - begin) / (end - begin)
        return interpolated(self.poses[k - 1], self.poses[k], share)


class TransformTree:
    """Frames and their poses in their parents, from the messages that announce them."""

    def __init__(self) -> None:
        self._links: dict[str, _Link] = {}

    def add(
        self, parent: str, child: str, stamp: int | None, pose: Transform, publisher: str = ""
    ) -> None:
        """Take the pose of a child in its parent.

        Parameters
        ----------
        parent, child
            Names of the frames.
        stamp
            The time [ns] at which it was true; `STILL` if it always is.
        pose
            The pose.
        publisher
            The node that published it; empty if that is not known.
        """
        link = self._links.get(child)
        if link is None or link.parent != parent:
            publishers = set() if link is None else link.publishers
            link = self._links[child] = _Link(parent, publishers=publishers)
        link.add(stamp, pose)
        if publisher:
            link.publishers.add(publisher)

    def begin(self) -> None:
        """Forget the publishers."""
        for link in self._links.values():
            link.publishers.clear()

    @property
    def frames(self) -> set[str]:
        """Names of all frames."""
        return {*self._links, *(link.parent for link in self._links.values())}

    def root(self, frame: str) -> str:
        """Return the frame in which all others of the tree of a frame are."""
        return [frame, *self._upward(frame)][-1]

    def latest(self, target: str, source: str) -> tuple[int, Transform] | None:
        """Return where `source` is in `target`, at the latest time that all of the chain knows.

        Links whose stamps differ are interpolated at that time [2]_.

        Returns
        -------
        tuple or None
            The time [ns], 0 of a chain that stands still, and the pose; None if the chain is not
            known, or at no common time.
        """
        chain = self._chain(target, source)
        if chain is None:
            return None
        up, down = chain
        links = [self._links[child] for child in (*up, *down)]
        common = min((link.stamps[-1] for link in links if link.stamps), default=0)
        poses = [link.at(common) for link in links]
        composed = IDENTITY
        for pose, downward in zip(poses, [False] * len(up) + [True] * len(down), strict=True):
            if pose is None:
                return None
            composed = composed @ (pose if downward else pose.inverse)
        return common, composed

    def publishers(self, target: str, source: str) -> dict[str, set[str]]:
        """Return the publishers of each frame on the way from `target` to `source`."""
        up, down = self._chain(target, source) or ([], [])
        return {child: self._links[child].publishers for child in (*up, *down)}

    def _chain(self, target: str, source: str) -> tuple[list[str], list[str]] | None:
        """Return the frames to go up from, and those to go down to; None if there is no way."""
        above = [target, *self._upward(target)]
        below = [source, *self._upward(source)]
        shared = next((frame for frame in above if frame in below), None)
        if shared is None:
            return None
        up = above[: above.index(shared)]
        return up, below[: below.index(shared)][::-1]

    def _upward(self, frame: str) -> Iterator[str]:
        """Yield the parents of a frame, up to the root."""
        seen = {frame}
        while frame in self._links and (frame := self._links[frame].parent) not in seen:
            seen.add(frame)
            yield frame
