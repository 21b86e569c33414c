"""Weak and strong scaling of training over processes: samples per second of 1, 2, ... processes.

    python -m benchmarks.bench_scaling --processes 1 2 > benchmarks/results/scaling.md

Every process runs the step of a stack (forward, backward, all-reduce, optimizer) on samples made up
in memory, compiled as in a long training: gloo on a CPU, NCCL where there is a GPU for each process. Weak scaling keeps the samples
per process, strong scaling those of all processes together.
"""

import argparse
import os
import socket
import time

import torch
from torch import distributed
from torch.multiprocessing import spawn
from torch.nn.parallel import DistributedDataParallel

from benchmarks.bench_training import batch, stack
from diffstack_mmv.types import map_tensors

NEIGHBORS = 4


def step_s(rank, processes, port, samples, steps, dynamics, results):
    """Seconds of a step of one process among others, by the clock and of its CPU; not the first."""
    torch.set_num_threads(1)
    os.environ |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port)}
    on_gpu = torch.cuda.device_count() >= processes
    device = torch.device("cuda", rank) if on_gpu else torch.device("cpu")
    distributed.init_process_group("nccl" if on_gpu else "gloo", rank=rank, world_size=processes)
    model = stack(dynamics).to(device)
    model.compile_kernels()
    model.log_dict = lambda *arguments, **options: None
    model.forward = lambda samples: model.training_step(samples, 0)
    trained = DistributedDataParallel(model, find_unused_parameters=True)
    optimizer = torch.optim.AdamW(model.parameters(), lr=1e-4)
    part = slice(rank * samples, (rank + 1) * samples)
    given = map_tensors(lambda tensor: tensor[part].to(device), batch(NEIGHBORS))
    for count in range(steps + 1):
        if count == 1:
            began_s, busy_s = time.perf_counter(), time.process_time()
        optimizer.zero_grad()
        trained(given).backward()
        optimizer.step()
        distributed.barrier()
    elapsed_s = time.perf_counter() - began_s, time.process_time() - busy_s
    results[rank] = tuple(seconds / steps for seconds in elapsed_s)
    distributed.destroy_process_group()


def measured_s(processes, samples, steps, dynamics):
    """Seconds of a step with so many processes and samples of each, of the slowest process."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with torch.multiprocessing.Manager() as manager:
        results = manager.dict()
        spawn(step_s, (processes, port, samples, steps, dynamics, results), processes)
        return [max(column) for column in zip(*results.values(), strict=True)]


def rows(options):
    """Scaling, processes, samples of each, both seconds of a step, samples per second, efficiency."""
    for name, share in (("weak", False), ("strong", True)):
        alone = None
        for processes in options.processes:
            samples = options.samples // processes if share else options.samples
            seconds, busy_s = measured_s(processes, samples, options.steps, options.dynamics)
            rate = samples * processes / seconds
            alone = alone or rate / processes
            yield name, processes, samples, seconds, busy_s, rate, rate / processes / alone


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--processes", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--samples", type=int, default=16)
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--dynamics", default="kbm")
    chosen = parser.parse_args()
    kind = torch.cuda.get_device_name() if torch.cuda.is_available() else f"{os.cpu_count()} cores"
    print(f"Training step of the stack with `dynamics={chosen.dynamics}` on {kind}, one thread per")
    print(f"process, {NEIGHBORS} neighbors, mean of {chosen.steps} steps.\n")
    print(
        "| scaling | processes | samples of each | step [s] | CPU of a process [s] | samples/s | efficiency |"
    )
    print("|---|---|---|---|---|---|---|")
    for scaling, count, samples, seconds, busy_s, rate, efficiency in rows(chosen):
        print(
            f"| {scaling} | {count} | {samples} | {seconds:.2f} | {busy_s:.2f} | {rate:.1f} "
            f"| {efficiency:.2f} |"
        )
