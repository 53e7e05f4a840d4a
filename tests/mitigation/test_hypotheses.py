"""Heads that agree on labelled frames and differ on the unlabelled."""

import numpy as np
import pytest
import torch

from astray.mitigation.hypotheses import (
    Frames,
    agreement,
    chosen_rightly,
    mutual_information,
    train_heads,
)


def frames(count, agree, seed=0):
    """Two features: in training the same, apart otherwise; a hypothesis is one of them."""
    random = np.random.default_rng(seed)
    one = random.random(count) < 0.3
    two = one if agree else random.random(count) < 0.3
    seen = np.stack([one, two], 1).astype(np.float32) + random.normal(0, 0.05, (count, 2))
    return Frames(seen.astype(np.float32), {"one": one, "two": two})


def test_mutual_information_is_that_of_the_joint_distribution():
    p = np.random.default_rng(0).random((50, 3))
    naive = 0.0
    for i, j in ((0, 1), (0, 2), (1, 2)):
        for a in (0, 1):
            for b in (0, 1):
                x, y = (p[:, i] if a else 1 - p[:, i]), (p[:, j] if b else 1 - p[:, j])
                joint = (x * y).mean()
                naive += joint * np.log(joint / (x.mean() * y.mean())) / 3
    assert float(mutual_information(torch.from_numpy(p))) == pytest.approx(naive, rel=1e-6)


def test_heads_that_are_made_to_differ_take_a_feature_each():
    known, other, test = frames(500, True), frames(500, False, 1), frames(500, False, 2)
    names = ["one", "two"]
    apart = train_heads(known, "one", other.seen, diversity=10.0, steps=200)
    assert agreement(apart, known_and(test, known), names).max(0) == pytest.approx(1, abs=0.1)
    alone = train_heads(known, "one", other.seen, diversity=0.0, steps=200)
    assert agreement(alone, test, names).max(0).min() < 0.9


def known_and(test, known):
    """All frames of both: those in which the hypotheses agree tell nothing."""
    labels = {n: np.concatenate([test.labels[n], known.labels[n]]) for n in test.labels}
    return Frames(np.concatenate([test.seen, known.seen]), labels)


class Fixed(torch.nn.Module):
    """Heads that answer by the features themselves."""

    def forward(self, seen):
        return seen.clamp(0, 1)


def test_agreement_and_labels_are_those_by_hand():
    one, two = np.array([1, 1, 0, 0, 1, 0], bool), np.array([1, 0, 1, 0, 0, 0], bool)
    made = Frames(np.stack([one, two], 1).astype(np.float32), {"one": one, "two": two})
    assert agreement(Fixed(), made, ["one", "two"]).tolist() == [[1, 0], [0, 1]]
    assert chosen_rightly(Fixed(), made, "one", [1, 3]) == [1.0, 1.0]
    half = Frames(made.seen, {"one": np.array([1, 1, 1, 0, 0, 0], bool)})
    # Of the frames in which the heads differ (1, 2, 4) the first head is right in one only.
    assert chosen_rightly(Fixed(), half, "one", [1])[0] == pytest.approx(2 / 3, abs=0.04)
    same = Frames(np.ones((4, 2), np.float32), {"one": np.ones(4, bool)})
    assert chosen_rightly(Fixed(), same, "one", [1, 8]) == [0.5, 0.5]


def test_a_label_that_no_frame_has_is_refused():
    known = frames(10, True)
    for label, message in (("nothing", "some of 10 frames must have"), ("three", "unknown label")):
        none = Frames(known.seen, {"nothing": np.zeros(10, bool)})
        with pytest.raises(ValueError, match=message):
            train_heads(none, label, known.seen, diversity=1.0, steps=1)
