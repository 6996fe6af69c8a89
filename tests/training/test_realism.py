"""How natural samples are: figures of distributions and of collisions, worked by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from advdiff_sumo.core.boxes import corners, separation
from advdiff_sumo.metrics.statistics import jensen_shannon
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.training.dataset import read_window_set
from advdiff_sumo.training.displacement import logged_rollout
from advdiff_sumo.training.evaluation import EvaluationSettings, evaluate_bundle
from advdiff_sumo.training.realism import _overlap as overlap
from advdiff_sumo.training.realism import (
    colliding,
    final_diversity,
    histograms,
    leaving_road,
)


def test_divergence_of_alike_disjoint_and_half_alike_histograms() -> None:
    p, q = np.array([1.0, 1.0, 0.0, 0.0]), np.array([0.0, 0.0, 2.0, 2.0])
    assert jensen_shannon(p, 3.0 * p) == pytest.approx(0.0)
    assert jensen_shannon(p, q) == pytest.approx(1.0)
    half = np.array([0.0, 1.0, 1.0, 0.0])
    assert jensen_shannon(p, half) == pytest.approx(0.5)
    assert np.isnan(jensen_shannon(p, np.zeros(4)))


@given(
    st.lists(st.floats(0, 100), min_size=5, max_size=5), st.lists(st.floats(0, 100), min_size=5, max_size=5)
)
def test_divergence_is_symmetric_and_between_0_and_1(a: list[float], b: list[float]) -> None:
    p, q = np.array(a) + 1e-3, np.array(b) + 1e-3
    found = jensen_shannon(p, q)
    assert found == pytest.approx(jensen_shannon(q, p), abs=1e-9)
    assert -1e-9 <= found <= 1.0 + 1e-9


def test_diversity_is_the_mean_distance_over_pairs() -> None:
    last = torch.tensor([[[[0.0, 0.0]], [[3.0, 4.0]], [[0.0, 0.0]]]])  # one scene, three samples, one vehicle
    assert final_diversity(last).tolist() == [[pytest.approx(10.0 / 3.0)]]
    assert final_diversity(last[:, :1]).tolist() == [[0.0]]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_boxes_overlap_as_in_core(seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy, yaw = rng.uniform(-4, 4, (5, 3, 2)), rng.uniform(-4, 4, (5, 3))
    size = rng.uniform(0.5, 5.0, (5, 2))
    found = overlap(*(torch.from_numpy(v)[None] for v in (xy, yaw, size)))[0]
    box = corners(xy, yaw, np.broadcast_to(size[:, None], (5, 3, 2)))
    one, other = np.broadcast_arrays(box[:, None], box[None])
    gap = separation(one, other)
    assert np.array_equal(found.numpy(), gap <= 0.0)


def test_the_log_of_a_free_road_has_neither_collisions_nor_departures(batch: SceneBatch) -> None:
    apart = replace(batch, size=batch.size * 0.01)
    assert not colliding(logged_rollout(apart), apart, apart.future_valid).any()
    assert not leaving_road(logged_rollout(batch), batch, batch.future_valid).any()


def test_a_car_that_leaves_the_road_is_found(batch: SceneBatch) -> None:
    true = logged_rollout(batch)
    aside = true.xy.clone()
    aside[:, 0, 5, 1] += 30.0
    gone = Rollout(aside, true.yaw, true.speed, true.accel, true.curvature)
    found = leaving_road(gone, batch, batch.future_valid)
    assert found[:, 0].all()
    assert not found[:, 1:].any()


def test_a_car_put_onto_another_one_collides_but_not_where_nobody_is(batch: SceneBatch) -> None:
    batch = replace(batch, size=torch.full_like(batch.size, 0.5))
    true = logged_rollout(batch)
    onto = true.xy.clone()
    onto[:, 0, 3] = onto[:, 1, 3]
    hit = Rollout(onto, true.yaw, true.speed, true.accel, true.curvature)
    found = colliding(hit, batch, batch.future_valid)
    assert found[:, 0].all()
    assert not found[:, 1].any()  # parked: no driving vehicle
    absent = batch.future_valid.clone()
    absent[:, 1, 3] = False
    assert not colliding(hit, batch, absent)[:, 0].any()


def test_histograms_count_known_instants_of_driving_vehicles(batch: SceneBatch) -> None:
    speed, accel = histograms(logged_rollout(batch), batch)
    driving = int((batch.present & ~batch.parked).sum())
    assert speed.sum() == accel.sum() == driving * 12


def test_next_to_an_instant_that_is_not_known_no_acceleration_is(batch: SceneBatch) -> None:
    """It was taken for a stand: of 10 m/s in half a second, 20 m/s²."""
    known = batch.future_valid.clone()
    known[:, :, 5] = False
    gap = replace(batch, future_valid=known, future=torch.where(known[..., None], batch.future, 0.0))
    speed, accel = histograms(logged_rollout(gap), gap)
    driving = int((batch.present & ~batch.parked).sum())
    assert speed.sum() == driving * 11
    assert accel.sum() == driving * 10
    whole = histograms(logged_rollout(batch), batch)[1]
    assert (accel <= whole).all()


def test_every_way_to_predict_has_its_row(bundle: Bundle, window_folder) -> None:
    windows = read_window_set([window_folder])
    trained = replace(bundle, stages=("traffic", "denoiser"))
    judging = EvaluationSettings(samples=3, steps=2, windows=6, batch_size=4)
    found = evaluate_bundle(trained, windows, judging, torch.device("cpu"))
    ways = ["constant velocity", "lane following", "posterior", "prior", "latent diffusion", "log"]
    assert list(found) == ways
    assert found == evaluate_bundle(trained, windows, judging, torch.device("cpu"))
    prior = found["prior"]
    assert prior["min_ade_m"] <= prior["ade_m"]
    assert prior["min_fde_m"] <= prior["min_sfde_m"] + 1e-6 or prior["fdd_m"] > 0.0
    assert "min_ade_m" not in found["log"]
    assert found["constant velocity"]["jsd_speed"] > 0.0
    assert list(evaluate_bundle(bundle, windows, judging, torch.device("cpu"))) == [*ways[:2], "log"]
