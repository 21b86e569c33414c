"""Windows per second of training and evaluation on a GPU, and on the processor beside it.

    python benchmarks/bench_gpu.py --save windows.pt CACHE      # where recordings are: 1,024 windows
    python benchmarks/bench_gpu.py windows.pt                   # where a GPU is

By the clock, with all threads, from windows in memory; each number is the median of the steps that
fit in the budget after two warm ones. Weights are those that the package ships, so that plans are
those of a trained predictor. "Libraries" is what a long training does, "tensors" the same without
them. First the loss and the length of its gradient on both devices are compared. Prints Markdown.
"""

import argparse
import statistics
import sys
import time
from pathlib import Path

import torch
from bench_throughput import MODELS, composed_stack, crowd, evaluation, training

from diffstack_mmv.types import map_tensors

SHIPPED = [
    "predictor.components=16",
    "predictor.neighbor_components=3",
    "predictor.sizes.decoder=64",
]
WINDOWS = 1024
WARM_UP = 2


def save(cache, data, path):
    """The first windows of a training, in its own order."""
    from bench_throughput import composed

    chosen = [f"data={data}", f"data.cache={Path(cache).resolve()}", f"batch_size={WINDOWS}"]
    torch.manual_seed(0)
    _, loaded = composed([*chosen, "data.neighbors=0"])
    loaded.prepare_data()
    loaded.setup("fit")
    torch.save(map_tensors(lambda field: field, next(iter(loaded.train_dataloader()))), path)


def stack_of(model, device, compiled, more=()):
    """A stack with the weights of the package, ready for steps."""
    shipped = {"unicycle": "pretrained/unicycle", "DiffGM3": "pretrained/gm3"}.get(
        model, "pretrained"
    )
    torch.manual_seed(0)
    stack = composed_stack([*MODELS[model], *SHIPPED, f"start={shipped}", "data.cache=none", *more])
    stack.log_dict = stack.log = lambda *given, **named: None
    if compiled:
        stack.compile_kernels()
    return stack.to(device)


def first(batch, count, neighbors, device):
    """So many windows on a device."""
    few = map_tensors(lambda field: field[:count], batch)
    return map_tensors(lambda field: field.to(device), crowd(few, neighbors))


def wait(device):
    if device == "cuda":
        torch.cuda.synchronize()


def timed(step, stack, optimizer, batch, device, budget_s):
    """Seconds of the first step, and the median of those that fit."""
    seconds, begun = [], time.perf_counter()
    while len(seconds) < WARM_UP + 1 or time.perf_counter() - begun < budget_s:
        start = time.perf_counter()
        step(stack, optimizer, batch)
        wait(device)
        seconds.append(time.perf_counter() - start)
        if len(seconds) == WARM_UP:
            begun = time.perf_counter()
    return seconds[0], statistics.median(seconds[WARM_UP:])


def agreement(model, batch, neighbors):
    """Loss and length of the gradient of a training step on each device."""
    found = []
    for device in ("cpu", "cuda"):
        stack = stack_of(model, device, compiled=True).eval()  # without dropout
        loss = stack.training_step(first(batch, 64, neighbors, device), 0)
        loss.backward()
        squares = [
            each.grad.square().sum().cpu() for each in stack.parameters() if each.grad is not None
        ]
        found.append((loss.item(), sum(squares).sqrt().item()))
    return found


def row(model, device, compiled, batch, budget_s, more):
    """Windows per second in training and evaluation, the first step, the peak of the device."""
    stack = stack_of(model, device, compiled, more)
    made = stack.configure_optimizers()
    optimizer = made["optimizer"] if isinstance(made, dict) else made
    count, rates, firsts = len(batch.goal), [], []
    if device == "cuda":
        torch.cuda.reset_peak_memory_stats()
    for work in (training, evaluation):
        stack.train(work is training)
        begun, each = timed(work, stack, optimizer, batch, device, budget_s)
        rates.append(count / each)
        firsts.append(begun)
    peak = torch.cuda.max_memory_allocated() / 2**20 if device == "cuda" else 0
    return *rates, firsts[0], peak


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("windows", type=Path)
    parser.add_argument("cache", type=Path, nargs="?")
    parser.add_argument("--save", action="store_true")
    parser.add_argument("--data", default="thab_vru")
    parser.add_argument("--models", nargs="+", default=list(MODELS), choices=list(MODELS))
    parser.add_argument("--batches", nargs="+", type=int, default=[64, 256, 1024])
    parser.add_argument("--neighbors", nargs="+", type=int, default=[0])
    parser.add_argument(
        "--codes", nargs="+", default=["libraries"], choices=["libraries", "tensors"]
    )
    parser.add_argument("--devices", nargs="+", default=["cuda", "cpu"])
    parser.add_argument("--override", action="append", default=[], help="as stack=mixed_precision")
    parser.add_argument("--budget", type=float, default=2.0, help="seconds of each measurement")
    parser.add_argument("--unchecked", action="store_true", help="do not compare the devices first")
    given = parser.parse_args()
    if given.save:
        return save(given.cache, given.data, given.windows)
    batch = torch.load(given.windows, weights_only=False)
    name = torch.cuda.get_device_name() if torch.cuda.is_available() else "no GPU"
    print(f"{name}, {torch.get_num_threads()} threads, torch {torch.__version__}.\n", flush=True)
    if not given.unchecked and "cuda" in given.devices:
        print("| model | loss, gradient: cpu | cuda |\n|---|---|---|")
        for model in given.models:
            told = [
                f"{loss:.6f}, {slope:.6f}"
                for loss, slope in agreement(model, batch, given.neighbors[0])
            ]
            print(f"| {model} | {told[0]} | {told[1]} |", flush=True)
        print()
    print(
        "| model | neighbors | batch | device | code | training, windows/s | evaluation, windows/s | first step, s | peak, MiB |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for model in given.models:
        for neighbors in given.neighbors:
            for device in given.devices:
                for code in given.codes:
                    for count in given.batches:
                        some = first(batch, count, neighbors, device)
                        rates = row(
                            model, device, code == "libraries", some, given.budget, given.override
                        )
                        print(
                            f"| {model} | {neighbors} | {count} | {device} | {code} | {rates[0]:.0f} |"
                            f" {rates[1]:.0f} | {rates[2]:.1f} | {rates[3]:.0f} |",
                            flush=True,
                        )
    return None


if __name__ == "__main__":
    try:
        main()
    except ValueError as refusal:  # of the stack: it says in one line what is wrong with the input
        sys.exit(str(refusal))
