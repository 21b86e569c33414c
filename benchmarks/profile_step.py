"""Where one training step goes: parts, operations, flame chart, and the floor of its arithmetic.

    python benchmarks/profile_step.py CACHE OUT [--data thab_vru] [--models DiffKBM ...] [--neighbors 16] [--override KEY=VALUE]

Writes OUT/profile.md, and for every model OUT/<model>.png (flame chart of one step) and
OUT/<model>.json.gz (the same for a trace viewer). One thread, batch 64, processor time, compiled as
a long training compiles itself; operations, bytes and flops are counted in one step on tensors,
where nothing is hidden in a library (--uncounted leaves that out: DiffGM3 takes a minute).
"""

import argparse
import collections
import contextlib
import sys
import time
from pathlib import Path

import matplotlib as mpl
import torch
from bench_solver_profile import rates
from bench_throughput import MODELS, composed, crowd, training
from matplotlib import pyplot as plt
from torch.profiler import ProfilerActivity, profile, record_function
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils.flop_counter import flop_registry

from diffstack_mmv.control.native import modules, prices, scan, solver
from dmmv_conventions import libraries

STEPS, PROFILED, SHOWN_OPERATIONS, SHOWN_SHARE = 5, 3, 12, 0.002
WIDTH_IN, CHARACTERS = 16, 190  # of the chart, and of a line of its labels
ENGINE = "autograd::engine::evaluate_function"
LIBRARIES = modules, prices, scan, solver, libraries
"""Modules that load libraries."""


class Counted(TorchDispatchMode):
    """Number of tensor operations, bytes of what they write, and flops of matrix products.

    `FlopCounterMode` would hook into every module, which functions do not bear that are
    differentiated forward inside of a backward pass.
    """

    IN_PLACE = {torch.ops.aten.addmm_: torch.ops.aten.addmm}

    def __init__(self):
        super().__init__()
        self.operations, self.bytes, self.flops = 0, 0, 0

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        out = func(*args, **(kwargs or {}))
        self.operations += 1
        packet = self.IN_PLACE.get(func._overloadpacket, func._overloadpacket)
        if packet in flop_registry:
            self.flops += flop_registry[packet](*args, **(kwargs or {}), out_val=out)
        for tensor in out if isinstance(out, list | tuple) else (out,):
            if isinstance(tensor, torch.Tensor) and not tensor._is_view():
                self.bytes += tensor.numel() * tensor.element_size()
        return out


class Watch:
    """Processor time of named parts, that of the parts inside included."""

    def __init__(self):
        self.seconds = collections.Counter()

    def around(self, name, function):
        def timed(*args, **kwargs):
            with self.part(name):
                return function(*args, **kwargs)

        return timed

    @contextlib.contextmanager
    def part(self, name):
        start = time.process_time()
        with record_function(name):
            yield
        self.seconds[name] += time.process_time() - start


class WatchedLibrary:
    """A library whose functions are parts."""

    def __init__(self, library, watch):
        self.library, self.watch = library, watch

    def __getattr__(self, name):
        told = f"library: {name.removeprefix('dmmv_')}"
        return self.watch.around(told, getattr(self.library, name))


def watch_libraries(watch):
    """Put a stop-watch around the functions of all libraries that are loaded from now on."""
    for module in LIBRARIES:
        plain = module.load
        module.load = lambda *given, plain=plain: WatchedLibrary(plain(*given), watch)


def watched(stack, watch):
    """Put a stop-watch around the parts of a stack."""
    for name in ("predict_and_judge", "loss"):
        wrapped = watch.around("prediction", getattr(stack.predictor, name))
        setattr(stack.predictor, name, wrapped)
    stack.plan = watch.around("plan", stack.plan)
    stack.planning_losses = watch.around("planning losses", stack.planning_losses)
    planner = stack.planner
    planner.candidates = watch.around("plan: candidates", planner.candidates)
    score = planner.score
    planner.score = watch.around("plan: scores", score)
    planner.score.differentiable = score.differentiable
    planner._solve = watch.around("plan: solver", planner._solve)


def stepped(watch, stack, optimizer, batch):
    """One step, its backward pass as a part."""
    optimizer.zero_grad(set_to_none=True)
    loss = stack.training_step(batch, 0)
    with watch.part("backward"):
        loss.backward()
    with watch.part("clip and optimizer"):
        torch.nn.utils.clip_grad_norm_(stack.parameters(), 1.0)
        optimizer.step()


def shown(event):
    """Whether an event gets a bar: not the engine's own around each operation of autograd."""
    return not event.name.startswith(ENGINE)


def depth_of(event):
    """Calls around an event that get a bar."""
    parent, depth = event.cpu_parent, 0
    while parent is not None:
        depth, parent = depth + shown(parent), parent.cpu_parent
    return depth


def label(name, share):
    """As much of a name as fits on a bar that takes a share of the width."""
    name, fits = name.removeprefix("_"), int(share * CHARACTERS)
    return name if len(name) <= fits else f"{name[: fits - 1]}\u2026" if fits > 3 else ""


def draw(events, path, title):
    """Flame chart: time to the right, calls within calls downwards."""
    first = min(event.time_range.start for event in events)
    whole = max(event.time_range.end for event in events) - first
    figure, axes = plt.subplots(figsize=(WIDTH_IN, 7))
    rows = collections.defaultdict(list)
    thread = collections.Counter(event.thread for event in events)
    lanes = {name: lane for lane, (name, _) in enumerate(thread.most_common())}
    for event in filter(shown, events):
        long = event.time_range.elapsed_us()
        if long > SHOWN_SHARE * whole:
            bar = event.time_range.start - first, long, event.name
            rows[lanes[event.thread], depth_of(event)].append(bar)
    order = {key: place for place, key in enumerate(sorted(rows))}
    colours, number = mpl.colormaps["Set3"], {}
    for key in sorted(rows):
        bars = sorted(rows[key])
        spans = [(1e-3 * start, 1e-3 * long) for start, long, _ in bars]
        fill = [colours(number.setdefault(name, len(number)) % 12) for *_, name in bars]
        axes.broken_barh(spans, (order[key], 0.9), facecolors=fill, edgecolors="white", lw=0.4)
        for start, long, name in bars:
            place = 1e-3 * (start + 0.002 * whole), order[key] + 0.45
            axes.text(*place, label(name, long / whole), fontsize=7, va="center", clip_on=True)
    axes.invert_yaxis()
    axes.set(xlabel="ms by the clock, profiler on", yticks=[], title=title, xlim=(0, 1e-3 * whole))
    figure.savefig(path, bbox_inches="tight", dpi=110)
    plt.close(figure)


def fastest(watch, stack, optimizer, batch):
    """Profile of the fastest of some steps: what else the machine does shows up as time, too."""
    found = []
    for _ in range(PROFILED):
        with profile(activities=[ProfilerActivity.CPU]) as profiler:
            start = time.perf_counter()
            stepped(watch, stack, optimizer, batch)
            seconds = time.perf_counter() - start
        found.append((seconds, profiler))
    return min(found, key=lambda each: each[0])[1]


def prepared(arguments, neighbors):
    """A stack in training, its optimizer, and batches with so many neighbors."""
    torch.manual_seed(0)
    stack, data = composed(arguments)
    stack.log_dict = stack.log = lambda *given, **named: None
    data.prepare_data()
    data.setup("fit")
    made = stack.configure_optimizers()
    optimizer = made["optimizer"] if isinstance(made, dict) else made
    stack.train()
    return stack, optimizer, (crowd(batch, neighbors) for batch in data.train_dataloader())


def floor(arguments, neighbors, rate):
    """Operations, bytes and flops of one step on tensors, and how long the last two take."""
    stack, optimizer, batches = prepared(arguments, neighbors)
    with Counted() as counted:
        stepped(Watch(), stack, optimizer, next(batches))
    compute, copy = rate
    arithmetic, traffic = counted.flops / compute, 2 * counted.bytes / copy
    return (
        f"On tensors {counted.operations} operations write {counted.bytes / 2**20:.0f} MiB"
        f" ({1e3 * traffic:.0f} ms to read and write once); matrix products"
        f" {1e-9 * counted.flops:.2f} GFLOP ({1e3 * arithmetic:.0f} ms at"
        f" {1e-9 * compute:.0f} GFLOP/s: the floor without fewer products)."
    )


def report(name, arguments, neighbors, folder, rate, watch):
    """Profile one model; returns its lines of Markdown. Without a rate nothing is counted."""
    stack, optimizer, batches = prepared(arguments, neighbors)
    stack.compile_kernels()
    for _ in range(2):
        training(stack, optimizer, next(batches))
    kept = [next(batches) for _ in range(STEPS)]
    watched(stack, watch)
    watch.seconds.clear()
    start = time.process_time()
    for batch in kept:
        stepped(watch, stack, optimizer, batch)
    whole = (time.process_time() - start) / STEPS
    parts = {part: seconds / STEPS for part, seconds in watch.seconds.items()}
    profiler = fastest(watch, stack, optimizer, kept[0])
    profiler.export_chrome_trace(str(folder / f"{name.replace(' ', '_')}.json.gz"))
    draw(profiler.events(), folder / f"{name.replace(' ', '_')}.png", f"{name}: one training step")
    lines = [
        f"## {name}: {1e3 * whole:.0f} ms a step, {64 / whole:.0f} windows/s",
        "",
        floor(arguments, neighbors, rate) if rate else "Operations not counted.",
        "",
        "| part | ms | share |",
        "|---|---|---|",
    ]
    lines += [
        f"| {part} | {1e3 * seconds:.1f} | {seconds / whole:.0%} |"
        for part, seconds in sorted(parts.items(), key=lambda row: -row[1])
    ]
    lines += ["", "| operation | calls | own ms |", "|---|---|---|"]
    averages = [row for row in profiler.key_averages() if not row.key.startswith(ENGINE)]
    averages.sort(key=lambda row: -row.self_cpu_time_total)
    lines += [
        f"| `{row.key}` | {row.count} | {1e-3 * row.self_cpu_time_total:.1f} |"
        for row in averages[:SHOWN_OPERATIONS]
    ]
    return [*lines, ""]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cache", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--data", default="thab_vru")
    parser.add_argument("--override", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--models", nargs="+", default=list(MODELS), choices=list(MODELS))
    parser.add_argument("--neighbors", type=int, default=0, help="agents placed around each ego")
    parser.add_argument("--uncounted", action="store_true", help="no step on tensors")
    given = parser.parse_args()
    torch.set_num_threads(1)
    given.out.mkdir(parents=True, exist_ok=True)
    watch = Watch()  # one for all models, which share libraries
    watch_libraries(watch)
    rate = None if given.uncounted else rates()
    lines = ["# Profile of one training step", ""]
    for name in given.models:
        common = [f"data={given.data}", f"data.cache={given.cache.resolve()}", "batch_size=64"]
        arguments = [*common, *MODELS[name], *given.override]
        lines += report(name, arguments, given.neighbors, given.out, rate, watch)
        (given.out / "profile.md").write_text("\n".join(lines))
    print("\n".join(lines))


if __name__ == "__main__":
    try:
        main()
    except ValueError as refusal:  # of the stack: it says in one line what is wrong with the input
        sys.exit(str(refusal))
