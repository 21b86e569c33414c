"""Windows per second of the predictor alone on one core, next to another checkout if one is given.

    python benchmarks/bench_predictor.py --cache CACHE --exports DIR [--neighbors 0 16] [--peer PATH]

Real tracks of `data=thab_vru`; the neighbors are the cyclists of the other windows, placed around
the ego. The predictor is trained for `--steps` steps first, because a backward pass costs what the
components that explain a track cost: all of them before training, a few of them after it. CPU time,
so that other processes disturb less.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import torch
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import OmegaConf, open_dict

from diffstack_mmv.types import Tracks
from diffstack_mmv.vehicles import config_folder

BATCH, ROUNDS = 64, 5


def configured(arguments):
    own = ["data=thab_vru", f"data.cache={arguments.cache}", "loss=prediction", "out=none"]
    own += [f"data.module.export.folder={arguments.exports}", f"dynamics={arguments.dynamics}"]
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        config = compose("train", own, return_hydra_config=True)
    HydraConfig.instance().set_config(config)
    with open_dict(config):
        config.pop("hydra")
    OmegaConf.resolve(config)
    return config


def crowd(batch, count):
    """The batch with so many neighbors, the egos of other windows within some metres."""
    index = (torch.arange(BATCH).unsqueeze(-1) + 1 + torch.arange(count)) % BATCH
    offset = 8 * torch.randn(BATCH, count, 1, 2, generator=torch.Generator().manual_seed(0))

    def others(tracks):
        taken = type(tracks.motion)(*(field[index] for field in tracks.motion))
        moved = taken._replace(position=taken.position + offset)
        return Tracks(moved, *(field[index] for field in tracks[1:]))

    return batch._replace(
        neighbors_past=others(batch.ego_past), neighbors_future=others(batch.ego_future)
    )


def milliseconds(function):
    function()
    times = []
    for _ in range(ROUNDS):
        start = time.process_time()
        function()
        times.append(1e3 * (time.process_time() - start))
    return sorted(times)[ROUNDS // 2]


def learning(predictor):
    return torch.optim.AdamW(predictor.parameters(), lr=2e-3, fused=True)


def trained(config, dataset, path, steps):
    """A predictor after some steps; the weights are kept in `path` for the peer."""
    torch.manual_seed(0)
    predictor = instantiate(config.stack).predictor
    if path.exists():
        predictor.load_state_dict(torch.load(path))
        return predictor
    optimizer = learning(predictor)
    for _ in range(steps):
        batch = dataset[torch.randint(len(dataset), (BATCH,)).tolist()]
        optimizer.zero_grad()
        predictor.loss(crowd(batch, 0)).mean().backward()
        torch.nn.utils.clip_grad_norm_(predictor.parameters(), 1.0)
        optimizer.step()
    torch.save(predictor.state_dict(), path)
    return predictor


def measured(predictor, dataset, count):
    """Milliseconds of each part for one batch."""
    numbers = list(range(0, len(dataset), len(dataset) // BATCH))[:BATCH]
    batch, optimizer = crowd(dataset[numbers], count), learning(predictor)

    def differentiated():
        predictor.zero_grad()
        predictor.loss(batch).mean().backward()

    def stepped():
        loaded = dataset[numbers] if count == 0 else batch
        optimizer.zero_grad()
        predictor.loss(loaded).mean().backward()
        torch.nn.utils.clip_grad_norm_(predictor.parameters(), 1.0)
        optimizer.step()

    def evaluated():
        with torch.no_grad():
            predictor.predict(batch)

    predictor.train()
    found = {
        "forward": milliseconds(lambda: predictor.loss(batch)),
        "forward and backward": milliseconds(differentiated),
    }
    weights = {name: value.clone() for name, value in predictor.state_dict().items()}
    found["training step"] = milliseconds(stepped)
    predictor.load_state_dict(weights)
    predictor.eval()
    found["evaluation"] = milliseconds(evaluated)
    return found


def results(arguments):
    torch.set_num_threads(1)
    config = configured(arguments)
    data = instantiate(config.data.module)
    data.prepare_splits(["train"])
    dataset = data.dataset("train")
    predictor = trained(config, dataset, arguments.weights, arguments.steps)
    return {str(count): measured(predictor, dataset, count) for count in arguments.neighbors}


def of_peer(arguments):
    """The same measurements with the package of another checkout."""
    command = [sys.executable, __file__, *sys.argv[1:], "--json", "--weights", arguments.weights]
    environment = os.environ | {"PYTHONPATH": str(arguments.peer)}
    return json.loads(subprocess.check_output([*map(str, command)], env=environment, text=True))


def table(found, peer):
    lines = ["| neighbors | part | ms | windows/s |" + (" peer ms | ratio |" if peer else "")]
    lines.append("|" + " --- |" * (lines[0].count("|") - 1))
    for count, parts in found.items():
        for part, value in parts.items():
            line = f"| {count} | {part} | {value:.0f} | {1e3 * BATCH / value:.0f} |"
            if peer:
                line += f" {peer[count][part]:.0f} | {peer[count][part] / value:.1f} |"
            lines.append(line)
    return "\n".join(lines) + "\n"


def parsed():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cache", required=True, help="cache of scripts/convert.py")
    parser.add_argument("--exports", required=True, help="folder for the exported windows")
    parser.add_argument("--dynamics", default="kbm")
    parser.add_argument("--neighbors", type=int, nargs="+", default=[0, 16])
    parser.add_argument("--steps", type=int, default=300, help="of training before measuring")
    parser.add_argument("--peer", type=Path, help="another checkout of this package")
    parser.add_argument("--weights", type=Path, default=None, help=argparse.SUPPRESS)
    parser.add_argument("--json", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args()


def main():
    arguments = parsed()
    with tempfile.TemporaryDirectory() as folder:
        arguments.weights = arguments.weights or Path(folder) / "weights.pt"
        found = results(arguments)
        if arguments.json:
            sys.stdout.write(json.dumps(found))
            return
        sys.stdout.write(table(found, of_peer(arguments) if arguments.peer else None))


if __name__ == "__main__":
    main()
