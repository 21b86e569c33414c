"""Windows per second of training and evaluation, of this code, eager and compiled, and of others.

    python benchmarks/bench_throughput.py CACHE [--data thab_vru] [--peer NAME=CHECKOUT ...]

Every row is a process of its own on one thread, end to end: loading, forward, losses, backward,
clipping and the optimizer's step; processor time, so that a busy machine counts little. A peer is a
checkout whose `train` configuration has the same groups (an older commit). Prints Markdown.

Every model is measured eagerly and compiled, as a long training compiles itself. `--neighbors 16`
places the egos of other windows around each ego, as in bench_predictor.py. How fast a training step is depends on how much the predictor has learned, since components that a
loss does not see are left out of its backward pass: `--variant trained=start=CHECKPOINT`.
"""

import argparse
import itertools
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[1]
MODELS = {
    "predictor alone": ["dynamics=kbm", "loss=prediction"],
    "unicycle": ["dynamics=unicycle"],
    "DiffKBM": ["dynamics=kbm"],
    "DiffGM3": ["dynamics=gm3"],
}
TRAINING, EVALUATION = "training", "evaluation"
COMPILED = "COMPILED"  # among the overrides: not one of them
WARM_UP_PAIRS = 10


def composed(arguments):
    """The stack and the data of `train` with these arguments, whatever the checkout."""
    from hydra.utils import instantiate

    config = _resolved(arguments)
    return _started(config), instantiate(config.data.module)


def composed_stack(arguments):
    """The stack of `train` with these arguments, without its data."""
    return _started(_resolved(arguments))


def _resolved(arguments):
    from hydra import compose, initialize_config_dir
    from hydra.core.hydra_config import HydraConfig
    from omegaconf import OmegaConf, open_dict

    import diffstack_mmv.commands.cli  # noqa: F401  registers the resolvers
    from diffstack_mmv.vehicles import config_folder

    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        config = compose("train", [*arguments, "out=none"], return_hydra_config=True)
    HydraConfig.instance().set_config(config)
    with open_dict(config):
        config.pop("hydra")
    OmegaConf.resolve(config)
    return config


def _started(config):
    """The stack, from a checkpoint where one is told."""
    from hydra.utils import instantiate

    stack = instantiate(config.stack)
    if config.get("start"):
        from diffstack_mmv.stack import start_from
        from dmmv_conventions.pretrained import checkpoint_path

        start_from(stack, checkpoint_path(config.start))
    return stack


def crowd(batch, count):
    """The batch with so many neighbors, the egos of other windows within some metres."""
    import torch

    if count == 0:
        return batch
    rows = len(batch.goal)
    index = (torch.arange(rows).unsqueeze(-1) + 1 + torch.arange(count)) % rows
    offset = 8 * torch.randn(rows, count, 1, 2, generator=torch.Generator().manual_seed(0))

    def others(tracks):
        taken = type(tracks.motion)(*(field[index] for field in tracks.motion))
        moved = taken._replace(position=taken.position + offset)
        return type(tracks)(moved, *(field[index] for field in tracks[1:]))

    return batch._replace(
        neighbors_past=others(batch.ego_past), neighbors_future=others(batch.ego_future)
    )


def training(stack, optimizer, batch):
    """One step as Lightning takes it."""
    import torch

    optimizer.zero_grad(set_to_none=True)
    loss = stack.training_step(batch, 0)
    loss.backward()
    torch.nn.utils.clip_grad_norm_(stack.parameters(), 1.0)
    optimizer.step()
    return loss.item()


def evaluation(stack, optimizer, batch):
    """All scores of a batch."""
    import torch

    with torch.no_grad():
        return float(sum(value.nansum() for value in stack.sample_scores(batch).values()))


def measure(work, budget_s, neighbors, arguments):
    """Warm up, then steps until the budget is spent; prints one line of JSON."""
    import torch

    torch.set_num_threads(1)
    torch.manual_seed(0)
    stack, data = composed([each for each in arguments if each != COMPILED])
    if COMPILED in arguments:
        stack.compile_kernels()
    stack.log_dict = stack.log = lambda *given, **named: None
    data.prepare_data()
    data.setup("fit")
    made = stack.configure_optimizers()
    optimizer = made["optimizer"] if isinstance(made, dict) else made
    step = {TRAINING: training, EVALUATION: evaluation}[work]
    stack.train(work == TRAINING)
    loaded = itertools.chain.from_iterable(data.train_dataloader() for _ in itertools.count())
    batches = (crowd(batch, neighbors) for batch in loaded)
    first, begun = time.perf_counter(), _used_s()
    step(stack, optimizer, next(batches))
    first, used = time.perf_counter() - first, _used_s() - begun
    for _ in range(WARM_UP_PAIRS):
        if _steady(step, stack, optimizer, batches):
            break
    windows, start = 0, time.process_time()
    while time.process_time() - start < budget_s:
        batch = next(batches)
        step(stack, optimizer, batch)
        windows += len(batch.goal)
    seconds = time.process_time() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    found = {"rate": windows / seconds, "first_s": first, "used_s": used, "peak_mib": peak}
    print(json.dumps(found))


def _used_s():
    """Processor time of this process and of the compilers that it ran."""
    return sum(os.times()[:4])


def _steady(step, stack, optimizer, batches):
    """Two steps; whether the second took no longer than four thirds of the first, or was short."""
    seconds = []
    for _ in range(2):
        start = time.process_time()
        step(stack, optimizer, next(batches))
        seconds.append(time.process_time() - start)
    return seconds[1] < 4 / 3 * seconds[0] or seconds[1] < 0.2


def row(checkout, work, budget_s, neighbors, arguments):
    """Measure in a process that sees only this checkout."""
    environment = os.environ | {"PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1"}
    command = [
        sys.executable,
        __file__,
        "--measure",
        work,
        str(budget_s),
        str(neighbors),
        *arguments,
    ]
    done = subprocess.run(
        command, env=environment, cwd=checkout, capture_output=True, text=True, check=False
    )
    if done.returncode:
        sys.exit(done.stderr)
    return json.loads(done.stdout.splitlines()[-1])


def main():
    if sys.argv[1:2] == ["--measure"]:
        return measure(sys.argv[2], float(sys.argv[3]), int(sys.argv[4]), sys.argv[5:])
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cache", type=Path)
    parser.add_argument("--data", default="thab_vru")
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--budget", type=float, default=20.0, help="seconds of each measurement")
    parser.add_argument("--neighbors", type=int, default=0, help="agents placed around each ego")
    parser.add_argument("--models", nargs="+", default=list(MODELS), choices=list(MODELS))
    parser.add_argument("--codes", nargs="*", default=["compiled", "eager"])
    parser.add_argument("--override", action="append", default=[], help="of all codes, as start=X")
    parser.add_argument("--peer", action="append", default=[], metavar="NAME=CHECKOUT")
    parser.add_argument("--variant", action="append", default=[], metavar="NAME=OVERRIDE,OVERRIDE")
    given = parser.parse_args()
    forms = {"compiled": [COMPILED], "eager": []}
    codes = [(name, CHECKOUT, [*forms[name], *given.override]) for name in given.codes]
    for variant in given.variant:
        name, _, overrides = variant.partition("=")
        codes.append((name, CHECKOUT, [COMPILED, *given.override, *overrides.split(",")]))
    for peer in given.peer:
        name, _, checkout = peer.partition("=")
        codes.append((name, Path(checkout).resolve(), list(given.override)))
    around = f", {given.neighbors} neighbors" if given.neighbors else ""
    print(f"{given.data}, batch {given.batch}, one thread{around}.\n")
    print(
        "| model | code | training, windows/s | evaluation, windows/s | first step: by the clock,"
        " processor, s | peak, MiB |"
    )
    print("|---|---|---|---|---|---|")
    for model in given.models:
        for name, checkout, more in codes:
            common = [f"data={given.data}", f"data.cache={given.cache.resolve()}"]
            arguments = [*common, *MODELS[model], f"batch_size={given.batch}", *more]
            trained = row(checkout, TRAINING, given.budget, given.neighbors, arguments)
            judged = row(checkout, EVALUATION, given.budget, given.neighbors, arguments)
            print(
                f"| {model} | {name} | {trained['rate']:.0f} | {judged['rate']:.0f} |"
                f" {trained['first_s']:.1f}, {trained['used_s']:.1f} | {trained['peak_mib']:.0f} |",
                flush=True,
            )
    return None


if __name__ == "__main__":
    try:
        main()
    except ValueError as refusal:  # of the stack: it says in one line what is wrong with the input
        sys.exit(str(refusal))
