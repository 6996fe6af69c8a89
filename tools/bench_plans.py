"""Measure the time of a plan of background 'diffusion' and of its stages, by number of vehicles: make bench.

Scenes hold vehicles that follow lanes of a shipped net; all but the target are planned. The plans of a row use a few
scenes in turn, with new random numbers each time. "SUMO" is the time of the episode loop for the half second between
two plans, with the same number of moved vehicles. The first plans of a process are slower and are left out.

If PyTorch finds a GPU, or with --device, a second table has the scenes per second of batched natural sampling.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from bench import STEPS, made_up_log, our_rate, scene_of
from rich.console import Console
from rich.table import Table

from advdiff_sumo.core.scene import Scene
from advdiff_sumo.diffusion import guides
from advdiff_sumo.diffusion.sampler import sample
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.shipped_nets import find_net
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.view import look
from advdiff_sumo.traffic import background_plan
from advdiff_sumo.traffic.diffusion import draw
from advdiff_sumo.traffic.diffusion.diffusion_policy import DiffusionTraffic

APART_M = 8.0
STAGES = ("view", "encoder", "denoiser", "guide", "decoder", "safeguard")
CLOCKS: dict[str, Callable[[], float]] = {"wall": time.perf_counter, "cpu": time.process_time}


class Stopwatch:
    """Adds up the times of wrapped functions by stage of a plan."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self.clock, self.spent = clock, defaultdict[str, float](float)

    def wrap(self, owner: Any, name: str, stage: str, minus: str = "") -> None:
        """Count the time of ``owner.name`` as *stage*, except the time of the stage *minus* within it."""
        function = getattr(owner, name)

        def timed(*args: Any, **kwargs: Any) -> Any:
            start, before = self.clock(), self.spent[minus]
            try:
                return function(*args, **kwargs)
            finally:
                self.spent[stage] += self.clock() - start - (self.spent[minus] - before if minus else 0.0)

        setattr(owner, name, timed)


def crowd(road: RoadMap, vehicles: int, seed: int) -> Scene:
    """Return a scene of a target and the *vehicles* nearest to it."""
    log, routes = made_up_log(road, max(400, 6 * vehicles), 10.0, seed)
    now = log.xy_m[:, 4]
    rows: list[int] = []
    for row in np.argsort(np.linalg.norm(now - now[0], axis=-1), kind="stable").tolist():
        if len(rows) <= vehicles and all(np.linalg.norm(now[row] - now[other]) > APART_M for other in rows):
            rows.append(row)
    history = log.rows(rows).window(0, 5)
    movable = np.arange(vehicles + 1) > 0
    return Scene(history, 0, movable, tuple(routes[row] for row in rows), {})


def measure(
    road: RoadMap, policy: DiffusionTraffic, vehicles: int, plans: int, watch: Stopwatch
) -> tuple[np.ndarray, np.ndarray]:
    """Return (plans,) the times of plans in ms, and (plans, stages) those of their stages."""
    rng = np.random.default_rng(vehicles)
    totals, parts = [], []
    scenes = [crowd(road, vehicles, seed) for seed in range(4)]
    for number in range(plans + 5):
        scene = scenes[number % len(scenes)]
        memory = policy.start(road, scene, None, rng)
        watch.spent.clear()
        start = watch.clock()
        policy.plan(road, scene, memory, rng)
        totals.append(1e3 * (watch.clock() - start))
        parts.append([1e3 * watch.spent[stage] for stage in STAGES])
    return np.array(totals[5:]), np.array(parts[5:])


def main() -> None:
    """Measure and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--net", type=Path, default=find_net("downtown"))
    parser.add_argument("--vehicles", type=int, nargs="+", default=[8, 24, 48, 96])
    parser.add_argument("--plans", type=int, default=60)
    parser.add_argument("--weights", default="", help="default: the shipped ones")
    parser.add_argument("--guide", choices=("reward", "none"), nargs="+", default=["reward", "none"])
    parser.add_argument("--licence", choices=("lawful", "careless", "reckless"), default="lawful")
    parser.add_argument(
        "--batches", type=int, nargs="+", default=[1, 16, 128], help="scenes sampled at once on --device"
    )
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "", help="for batches")
    parser.add_argument("--clock", choices=tuple(CLOCKS), default="wall", help="cpu on a busy machine")
    arguments = parser.parse_args()
    road = RoadMap.read(arguments.net)
    watch = Stopwatch(CLOCKS[arguments.clock])
    watch.wrap(background_plan, "look", "view")
    watch.wrap(background_plan, "lanes_of", "view")
    watch.wrap(draw, "encode", "encoder")
    watch.wrap(draw, "guidance", "guide")
    watch.wrap(guides.Guidance, "__call__", "guide")
    watch.wrap(draw, "sample", "denoiser", minus="guide")
    watch.wrap(draw, "decode", "decoder")
    watch.wrap(background_plan, "apply_safeguard", "safeguard")
    console = Console(width=120)
    for guide in arguments.guide:
        policy = DiffusionTraffic(weights=arguments.weights, guide=guide, licence=arguments.licence)
        setting = f"guide {guide}, {arguments.licence}, {policy.options.steps} steps"
        title = f"one plan in ms ({arguments.clock} time), {road.name}, {setting}"
        table = Table(title=title, title_justify="left")
        for name in ("vehicles", "median", "99 %", *STAGES, "SUMO", "× real time"):
            table.add_column(name, justify="right")
        for vehicles in arguments.vehicles:
            total, parts = measure(road, policy, vehicles, arguments.plans, watch)
            sumo_ms = 5e3 / sumo_rate(road, vehicles)
            stages = [f"{value:.1f}" for value in np.median(parts, axis=0)]
            median, p99 = np.median(total), np.percentile(total, 99)
            real_time_factor = 500.0 / (median + sumo_ms)
            times = (f"{median:.1f}", f"{p99:.1f}", *stages, f"{sumo_ms:.1f}")
            table.add_row(str(vehicles), *times, f"{real_time_factor:.1f}")
        console.print(table)
    if arguments.device:
        policy = DiffusionTraffic(weights=arguments.weights, guide="none", device=arguments.device)
        console.print(batched(road, policy, arguments.vehicles, arguments.batches))


def batched(road: RoadMap, policy: DiffusionTraffic, vehicles: list[int], batches: list[int]) -> Table:
    """Return a table of scenes per second by number of vehicles and number of scenes in a batch."""
    device = policy.networks.device
    table = Table(title=f"scenes per second on {device}, {policy.options.steps} steps", title_justify="left")
    for name in ("vehicles", *(f"{count} at once" for count in batches)):
        table.add_column(name, justify="right")
    for number in vehicles:
        batch = look(road, crowd(road, number, 0)).batch.to(device)
        table.add_row(str(number), *(f"{sampling_rate(policy, batch.repeat(n)):.0f}" for n in batches))
    return table


def sampling_rate(policy: DiffusionTraffic, batch: SceneBatch, rounds: int = 5) -> float:
    """Return scenes per second of encoder, denoiser and decoder on *batch*."""
    networks, generator, times = policy.networks, torch.Generator().manual_seed(0), []
    latent = networks.bundle.options.model.latent
    for _ in range(rounds + 2):
        start = time.perf_counter()
        with torch.no_grad():
            context = draw.encode(networks, batch)
            noise = torch.randn(batch.scenes, batch.agents, 1, latent, generator=generator)
            noise_of = networks.denoiser(context)
            x = sample(noise_of, noise.to(networks.device), networks.schedule, networks.sampling, generator)
            draw.decode(networks, x, context, batch).xy.cpu()  # waits for the device
        times.append(time.perf_counter() - start)
    return batch.scenes / float(np.median(times[2:]))


def sumo_rate(road: RoadMap, vehicles: int) -> float:
    """Return steps per second of the episode loop with background ``replay``, whose plans take almost no time."""
    duration = (STEPS + 10) * 0.1
    log, routes = made_up_log(road, vehicles + 1, duration, seed=vehicles)
    return our_rate(road, scene_of(road, log, routes, duration))


if __name__ == "__main__":
    main()
