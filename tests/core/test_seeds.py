"""The seed tree: stable over processes and versions, children independent."""

from __future__ import annotations

import hashlib

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.core.seeds import SeedTree

RECORDED = {"root": 804681139, "episode": 1113560939, "draws": [435, 602, 961]}


def test_the_numbers_are_those_of_sha256() -> None:
    expected = int.from_bytes(hashlib.sha256(b"42\x1fepisode\x1f3").digest()[:8], "big")
    node = SeedTree(42).child("episode", 3)
    assert node.integer(64) == expected
    assert node.integer() == expected >> 33
    assert SeedTree(0).integer(64) == int.from_bytes(hashlib.sha256(b"0").digest()[:8], "big")


def test_the_numbers_never_change() -> None:
    """Recorded once; a change here would change every earlier run."""
    assert SeedTree(0).integer() == RECORDED["root"]
    assert SeedTree(1).child("episode", 0).integer() == RECORDED["episode"]
    assert SeedTree(1).child("episode", 0).generator().integers(1000, size=3).tolist() == RECORDED["draws"]


def test_a_child_of_a_child_is_the_child_of_both_names() -> None:
    assert SeedTree(5).child("a").child("b") == SeedTree(5).child("a", "b")
    assert SeedTree(5).child("ab") != SeedTree(5).child("a", "b")
    assert SeedTree(5).child("ab").integer() != SeedTree(5).child("a", "b").integer()


def test_drawing_from_one_child_never_shifts_another() -> None:
    root = SeedTree(9)
    before = root.child("target").generator().random(4)
    noisy = root.child("background").generator()
    noisy.random(1000)
    assert (root.child("target").generator().random(4) == before).all()
    assert (
        root.child("target").generator().random(4) != root.child("background").generator().random(4)
    ).all()


def test_children_look_independent() -> None:
    draws = np.array([SeedTree(3).child("episode", k).generator().standard_normal(400) for k in range(60)])
    correlation = np.corrcoef(draws) - np.eye(60)
    assert np.abs(correlation).max() < 0.25  # five standard errors of 1/sqrt(400)
    assert abs(draws.mean()) < 0.03


@given(st.integers(0, 2**40), st.lists(st.text(max_size=5), max_size=4), st.integers(1, 64))
def test_integers_keep_their_bits(root: int, path: list[str], bits: int) -> None:
    node = SeedTree(root).child(*path)
    assert 0 <= node.integer(bits) < 2**bits
    assert node.integer(bits) == node.integer(64) >> (64 - bits)


@given(st.integers(0, 10**6), st.integers(0, 10**6))
def test_other_roots_give_other_numbers(a: int, b: int) -> None:
    same = SeedTree(a).child("x").integer(64) == SeedTree(b).child("x").integer(64)
    assert same == (a == b)
