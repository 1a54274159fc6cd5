"""Splits of pushes into training and held-out ones."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import NamedTuple

import numpy as np

from fixel.errors import InvalidInput
from fixel.typing import IntArray


class Split(NamedTuple):
    """Disjoint training and held-out members of a group, by index."""

    train: IntArray
    held_out: IntArray


def random_split(strata: Sequence[Hashable], share: float, seed: int) -> Split:
    """Select a random share of every stratum for training, and hold out the rest.

    Parameters
    ----------
    strata : (n,) sequence
        Stratum of each member, for instance its speed.
    share : float
        Share for training, between 0 and 1.
    """
    if not 0.0 < share < 1.0:
        raise InvalidInput("share", found=share, expected="a number between 0 and 1")
    rng = np.random.default_rng(seed)
    train: list[int] = []
    for own in _members(strata):
        train += rng.permutation(own)[: round(share * len(own))].tolist()
    return _split(train, len(strata))


def folds(strata: Sequence[Hashable], n: int, seed: int) -> list[Split]:
    """Create splits that hold out every member exactly once, with each stratum spread evenly."""
    if not 2 <= n <= max(len(strata), 2):
        raise InvalidInput("--folds", found=n, expected=f"2 to {len(strata)}")
    rng = np.random.default_rng(seed)
    fold = np.zeros(len(strata), np.int64)
    dealt = 0
    for own in _members(strata):
        fold[rng.permutation(own)] = (dealt + np.arange(len(own))) % n
        dealt += len(own)
    return [Split(np.flatnonzero(fold != k), np.flatnonzero(fold == k)) for k in range(n)]


def split_without(labels: IntArray, label: int, seed: int) -> Split:
    """Split that trains on three quarters of the members of every label except one.

    All members of that label, such as a side, and the remaining quarters are held out.
    """
    rng = np.random.default_rng(seed)
    train: list[int] = []
    for own in np.unique(labels[labels != label]).tolist():
        members = rng.permutation(np.flatnonzero(labels == own))
        train += members[: round(0.75 * len(members))].tolist()
    return _split(train, len(labels))


def few_of(split: Split, n: int, seed: int) -> Split:
    """Reduce the training members to `n` random ones; held-out members stay the same."""
    rng = np.random.default_rng(seed)
    return split._replace(train=np.sort(rng.permutation(split.train)[:n]))


def _members(strata: Sequence[Hashable]) -> list[IntArray]:
    names = list(dict.fromkeys(strata))
    number = {name: k for k, name in enumerate(names)}
    which = np.array([number[name] for name in strata], np.int64)
    return [np.flatnonzero(which == k) for k in range(len(names))]


def _split(train: Sequence[int], n: int) -> Split:
    learned = np.zeros(n, bool)
    learned[list(train)] = True
    return Split(np.flatnonzero(learned), np.flatnonzero(~learned))
