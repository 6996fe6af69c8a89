"""The loop: resumed to the byte, stopped in time, and never on with numbers that are none."""

from __future__ import annotations

import json
import math
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from advdiff_sumo.core.errors import ConfigError, TrainingError, WeightsError
from advdiff_sumo.data.window_files import read_windows, write_windows
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.shipped_weights import WEIGHTS
from advdiff_sumo.models.simnet import load_simnet
from advdiff_sumo.training import checkpoint
from advdiff_sumo.training.ema import Ema
from advdiff_sumo.training.history import NoEvents
from advdiff_sumo.training.learning_rates import rate_factor
from advdiff_sumo.training.presets import STAGES, StageName, TrainOptions, preset
from advdiff_sumo.training.setup import TrainingRequest, prepare
from advdiff_sumo.training.stage import Moment
from advdiff_sumo.training.training_loop import Trainer, TrainingJob
from tests.training.straight_road import write

SMALL_NETWORKS = [
    "model={hidden=16, latent=8, edge=8, heads=2, interaction_layers=1, channels=[8, 8, 8], reward_hidden=16}",
    "diffusion_steps=20",
]


def options(stage: StageName = "traffic", *more: str) -> TrainOptions:
    return preset("small", stage, [*SMALL_NETWORKS, "batch_size=3", "epochs=2", "held_out=0.3", *more])


def job(
    folder: Path, out: Path, stage: StageName = "traffic", init: Path | None = None, *more: str
) -> TrainingJob:
    out.mkdir(exist_ok=True)
    return prepare(TrainingRequest(stage, (folder,), out, options(stage, *more), init, seed=4, device="cpu"))


def run(made: TrainingJob, resume: bool = False, stop_after: int | None = None) -> None:
    """Train; with *stop_after*, Ctrl-C comes in that step."""

    def on_progress(progress: checkpoint.TrainingProgress, *_: object) -> None:
        if progress.step == stop_after:
            signal.raise_signal(signal.SIGINT)

    trainer = Trainer(made, NoEvents(), on_progress)
    if resume:
        trainer.resume()
    if stop_after is None:
        trainer.run()
    else:
        with pytest.raises(KeyboardInterrupt):
            trainer.run()


def files(out: Path) -> dict[str, bytes]:
    return {name: (out / name).read_bytes() for name in (checkpoint.NAME, WEIGHTS, "metrics.jsonl")}


def test_an_interrupted_training_ends_with_the_bytes_of_an_undisturbed_one(
    window_folder: Path, tmp_path: Path
) -> None:
    run(job(window_folder, tmp_path / "whole"))
    run(job(window_folder, tmp_path / "parts"), stop_after=2)
    assert not (tmp_path / "parts" / WEIGHTS).exists()
    run(job(window_folder, tmp_path / "parts"), resume=True, stop_after=4)
    run(job(window_folder, tmp_path / "parts"), resume=True)
    assert files(tmp_path / "parts") == files(tmp_path / "whole")
    assert (tmp_path / "parts" / "curves.png").read_bytes()[:4] == b"\x89PNG"


def test_processes_that_prepare_batches_change_no_byte(window_folder: Path, tmp_path: Path) -> None:
    run(job(window_folder, tmp_path / "alone", "traffic", None, "jitter.mirror=0.5"))
    helped = replace(job(window_folder, tmp_path / "helped", "traffic", None, "jitter.mirror=0.5"), loaders=2)
    run(helped)
    assert files(tmp_path / "helped") == files(tmp_path / "alone")


@pytest.mark.slow
def test_the_later_stages_resume_to_the_same_bytes_too(window_folder: Path, tmp_path: Path) -> None:
    init = tmp_path / "traffic"
    run(job(window_folder, init, "traffic", None, "epochs=1"))
    for stage in STAGES[1:]:
        whole, parts = tmp_path / stage, tmp_path / f"{stage}-parts"
        run(job(window_folder, whole, stage, init, "reward.transitions=1"))
        run(job(window_folder, parts, stage, init, "reward.transitions=1"), stop_after=1)
        run(job(window_folder, parts, stage, init, "reward.transitions=1"), resume=True)
        assert files(parts) == files(whole), stage
        init = whole


def test_time_over_is_no_end(window_folder: Path, tmp_path: Path) -> None:
    made = replace(job(window_folder, tmp_path / "out"), max_minutes=0.0)
    progress = Trainer(made, NoEvents(), lambda *_: None).run()
    assert (progress.done, progress.step) == (False, 0)
    assert checkpoint.load(tmp_path / "out")[0] == progress


def test_it_stops_when_held_out_drives_show_no_progress(window_folder: Path, tmp_path: Path) -> None:
    made = job(window_folder, tmp_path / "out", "traffic", None, "patience_epochs=2", "epochs=50")
    made.stage.evaluate = lambda *_: {"loss": (1.0, 1.0)}  # type: ignore[method-assign]  # a plateau
    progress = Trainer(made, NoEvents(), lambda *_: None).run()
    assert (progress.done, progress.epoch, progress.best_epoch) == (True, 3, 1)


def test_a_loss_that_is_no_number_names_the_step(window_folder: Path, tmp_path: Path) -> None:
    made = job(window_folder, tmp_path / "out")
    honest = made.stage.loss

    def broken(batch: SceneBatch, moment: Moment) -> dict[str, torch.Tensor]:
        terms = honest(batch, moment)
        return terms | {"kl": terms["kl"] * math.nan} if moment.step == 1 else terms

    made.stage.loss = broken  # type: ignore[method-assign]  # the fault that is to be found
    with pytest.raises(TrainingError, match=r"step 1 of epoch 1: 'kl' is nan"):
        Trainer(made, NoEvents(), lambda *_: None).run()


def test_a_gradient_that_is_no_number_is_found(window_folder: Path, tmp_path: Path) -> None:
    made = job(window_folder, tmp_path / "out")
    weight = next(iter(made.stage.module.parameters()))
    weight.register_hook(lambda gradient: gradient * math.inf)
    with pytest.raises(TrainingError, match="'gradient' is"):
        Trainer(made, NoEvents(), lambda *_: None).run()


@pytest.mark.parametrize(
    ("change", "match"),
    [("batch_size=4", "batch_size = 3, not 4"), ("learning_rate=0.1", "learning_rate")],
)
def test_other_options_do_not_go_on(window_folder: Path, tmp_path: Path, change: str, match: str) -> None:
    run(job(window_folder, tmp_path / "out"), stop_after=1)
    made = job(window_folder, tmp_path / "out", "traffic", None, change)
    with pytest.raises(ConfigError, match=match):
        Trainer(made, NoEvents(), lambda *_: None).resume()


def test_other_data_do_not_go_on(window_folder: Path, tmp_path: Path) -> None:
    run(job(window_folder, tmp_path / "out"), stop_after=1)
    other = write(tmp_path / "other", count=12, seed=8).parent
    with pytest.raises(ConfigError, match="other data"):
        Trainer(job(other, tmp_path / "out"), NoEvents(), lambda *_: None).resume()


def test_there_is_nothing_to_resume(window_folder: Path, tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="no such checkpoint"):
        Trainer(job(window_folder, tmp_path / "out"), NoEvents(), lambda *_: None).resume()


def test_a_truncated_checkpoint_is_refused(window_folder: Path, tmp_path: Path) -> None:
    run(job(window_folder, tmp_path / "out"), stop_after=1)
    path = tmp_path / "out" / checkpoint.NAME
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(WeightsError, match="cannot be read"):
        checkpoint.load(tmp_path / "out")


def test_each_epoch_is_one_line(window_folder: Path, tmp_path: Path) -> None:
    run(job(window_folder, tmp_path / "out"))
    lines = [json.loads(line) for line in (tmp_path / "out" / "metrics.jsonl").read_text().splitlines()]
    assert [line["epoch"] for line in lines] == [1, 2]
    assert {"loss", "reconstruction", "kl"} <= set(lines[0]["train"]) & set(lines[0]["held_out"])


def test_the_average_follows_and_is_taken_back() -> None:
    module = torch.nn.Linear(1, 1, bias=False)
    torch.nn.init.constant_(module.weight, 0.0)
    ema = Ema(module, decay=0.5)
    torch.nn.init.constant_(module.weight, 1.0)
    ema.update(step=0)  # young: keeps (1 + 0) / (10 + 0) of the old
    assert ema.shadow["weight"].item() == pytest.approx(0.9)
    torch.nn.init.constant_(module.weight, 2.0)
    ema.update(step=1000)
    assert ema.shadow["weight"].item() == pytest.approx(0.5 * 0.9 + 0.5 * 2.0)
    with ema.applied():
        assert module.weight.item() == pytest.approx(1.45)
    assert module.weight.item() == 2.0


def test_learning_rates() -> None:
    assert rate_factor("constant", 7, 10) == 1.0
    assert rate_factor("cosine", 0, 10) == 1.0
    assert rate_factor("cosine", 5, 10) == pytest.approx(0.5 * (1.0 + 0.002))
    assert rate_factor("cosine", 10, 10) == pytest.approx(0.002)
    assert rate_factor("one-cycle", 0, 10, 0.2) == pytest.approx(0.04)
    assert rate_factor("one-cycle", 2, 10, 0.2) == pytest.approx(1.0)
    assert rate_factor("one-cycle", 10, 10, 0.2) == pytest.approx(0.002)


def test_another_seed_is_no_resumed_training(window_folder: Path, tmp_path: Path) -> None:
    run(job(window_folder, tmp_path / "out"), stop_after=1)
    with pytest.raises(ConfigError, match="was begun with --seed 4, not 6"):
        run(replace(job(window_folder, tmp_path / "out"), seed=6), resume=True)


def test_a_training_of_before_an_option_went_goes_on(window_folder: Path, tmp_path: Path) -> None:
    run(job(window_folder, tmp_path / "whole"))
    out = tmp_path / "out"
    run(job(window_folder, out), stop_after=2)
    progress, groups = checkpoint.load(out)
    progress.options["elbo"]["prior_weight"] = 0.0
    checkpoint.save(out, progress, groups)
    assert TrainOptions.parse(checkpoint.load(out)[0].options).elbo == options().elbo
    run(job(window_folder, out), resume=True)
    assert files(out) == files(tmp_path / "whole")


def test_a_training_with_an_option_that_went_does_not_go_on(window_folder: Path, tmp_path: Path) -> None:
    run(job(window_folder, tmp_path), stop_after=1)
    progress, groups = checkpoint.load(tmp_path)
    progress.options["elbo"]["prior_weight"] = 0.5
    checkpoint.save(tmp_path, progress, groups)
    with pytest.raises(ConfigError, match=r"no option 'elbo\.prior_weight'"):
        TrainOptions.parse(checkpoint.load(tmp_path)[0].options)


def test_returns_longer_than_a_window_are_refused() -> None:
    with pytest.raises(ConfigError, match="execute × returns = 14: the future of a window has 12 steps"):
        preset("small", "reward", ["reward.returns=7"])


def test_sizes_of_a_new_denoiser_are_those_that_are_asked_for(window_folder: Path, tmp_path: Path) -> None:
    init = tmp_path / "traffic"
    run(job(window_folder, init, "traffic", None, "epochs=1"))
    own = job(window_folder, tmp_path / "own", "denoiser", init, "model.denoiser_layers=0")
    usual = job(window_folder, tmp_path / "usual", "denoiser", init)
    sizes = [made.stage.bundle.options.model for made in (own, usual)]
    assert [size.denoiser_layers for size in sizes] == [0, 1]
    assert sizes[0].model_copy(update={"denoiser_layers": 1}) == sizes[1]
    with pytest.raises(
        ConfigError, match=r"model.edge = 16: the networks of .*traffic have 8, and the stage"
    ):
        job(window_folder, tmp_path / "refused", "denoiser", init, "model.edge=16")


def test_a_denoiser_that_is_trained_on_keeps_its_sizes_and_noise(window_folder: Path, tmp_path: Path) -> None:
    init, known = tmp_path / "traffic", tmp_path / "denoiser"
    run(job(window_folder, init, "traffic", None, "epochs=1"))
    run(job(window_folder, known, "denoiser", init, "epochs=1", "noise_schedule=linear"))
    for asked, said in (
        ("model.denoiser_layers=0", r"model.denoiser_layers = 0: the networks of .*denoiser have 1"),
        ("diffusion_steps=50", r"diffusion_steps = 50: the denoiser of .*denoiser has 20, and the stage"),
        (
            "noise_schedule=cosine",
            "noise_schedule = cosine: the denoiser of .*denoiser has linear",
        ),  # the usual one
        (f"model.edge={ModelOptions().edge}", r"model.edge = \d+: the networks of .*denoiser have 8"),
    ):
        with pytest.raises(ConfigError, match=said):
            job(window_folder, tmp_path / "refused", "denoiser", known, asked)
    for stage in ("denoiser", "joint", "reward"):
        more = ["model.denoiser_situation=true"] if stage == "denoiser" else []
        made = job(window_folder, tmp_path / stage, stage, known, *more)
        assert (made.options.diffusion_steps, made.options.noise_schedule) == (20, "linear")
        assert made.stage.bundle.options.schedule == "linear"
        assert made.options.model.denoiser_situation == (stage == "denoiser")
    with pytest.raises(ConfigError, match="diffusion_steps = 50: the denoiser"):
        job(window_folder, tmp_path / "refused", "reward", known, "diffusion_steps=50")
    anew = job(window_folder, tmp_path / "anew", "denoiser", init, "diffusion_steps=50")
    assert anew.stage.bundle.options.diffusion_steps == 50


def far(folder: Path, out: Path) -> Path:
    """Return a folder of the windows of *folder*, as they are where the map is shown as far as 6 s lead."""
    (path,) = folder.glob("*.safetensors")
    near = read_windows(path)
    out.mkdir()
    wider = np.pad(near.near, ((0, 0), (0, 24)), constant_values=-1)
    write_windows(out / "far.safetensors", replace(near, near=wider))
    return out


@pytest.mark.parametrize("stage", ["traffic", "simnet"])
def test_held_out_windows_show_the_same_view_of_the_map(
    stage: StageName, window_folder: Path, tmp_path: Path
) -> None:
    both = window_folder, far(window_folder, tmp_path / "far")
    for (data, val), sees in ((both, "near"), (both[::-1], "far")):
        plan = TrainingRequest(stage, (data,), tmp_path / "out", options(stage), val=(val,), device="cpu")
        with pytest.raises(
            ConfigError, match=f"the windows of --val show .*the networks see '{sees}': .*--map-view {sees}"
        ):
            prepare(plan)
    assert len(prepare(replace(plan, val=plan.data)).held_out) == 12


def test_simnet_sees_of_the_map_what_its_windows_show(window_folder: Path, tmp_path: Path) -> None:
    """New networks take the view of the windows; those of another view cannot go on with them."""
    wide = far(window_folder, tmp_path / "far")
    run(job(wide, tmp_path / "out", "simnet", None, "epochs=1"))
    assert load_simnet(tmp_path / "out" / WEIGHTS).options.map_view == "far"
    with pytest.raises(ConfigError, match="the windows show the map's 'near' view, but the networks see"):
        job(window_folder, tmp_path / "refused", "simnet", tmp_path / "out", "epochs=1")
