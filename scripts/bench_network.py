"""The PyTorch side of `cargo bench --profile dev -- network SCENES`, which starts this program and takes turns with it.

    pip install -r scripts/requirements-torch.txt

Reads the weights and batches that the benchmark wrote into a folder, writes its own output for the first batch beside them, says
what it runs on, and then answers each line of stdin (`forward BATCH`, `train BATCH`, `sample FUTURES STEPS`) with the
seconds that this took, on the clock and of the processor.
"""

import argparse
import pathlib
import sys
import time

import torch
from safetensors.torch import load_file, save_file
from torch_geometric_network import BoundDenoiser
from torch_reference import Denoiser, read_checkpoint


def bind(spec, weights, batch, n_samples=1):
    """The denoiser of `n_samples` of each row, as a function of x and sigma. What samples of the geometric network share is computed here."""
    if spec["network"].get("geometry"):
        return BoundDenoiser(spec, weights, batch, n_samples)
    denoiser = Denoiser(spec, weights)
    batch = {name: tensor.expand(len(tensor) * n_samples, *tensor.shape[1:]) for name, tensor in batch.items()}
    return lambda x, sigma: denoiser(x, sigma, batch)


def loss(denoiser, batch):
    error = (denoiser(batch["x"], batch["sigma"]) - batch["x0"]) * batch["latent"][..., None]
    return (error.square() * batch["weight"]).sum() / (batch["latent"].sum() * error.shape[-1])


def heun(edm, denoiser, batch, n_futures, n_steps):
    """EDM's sampler without churn, on the noise levels of EDM's schedule, all futures of one scene as one batch."""
    rho, low, high = edm["rho"], edm["sigma_min"], edm["sigma_max"]
    ramp = torch.linspace(0, 1, n_steps)
    sigmas = [*(high ** (1 / rho) + ramp * (low ** (1 / rho) - high ** (1 / rho))) ** rho, torch.tensor(0.0)]
    x = torch.randn(n_futures, *batch["x0"].shape[1:]) * sigmas[0] * batch["latent"][..., None]
    for now, later in zip(sigmas, sigmas[1:]):
        slope = (x - denoiser(x, now.expand(n_futures))) / now
        moved = x + (later - now) * slope
        if later > 0:
            second = (moved - denoiser(moved, later.expand(n_futures))) / later
            moved = x + (later - now) * (slope + second) / 2
        x = moved
    return x


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    spec, named = read_checkpoint(arguments.folder / "model.safetensors")
    batches = {}
    for name, tensor in load_file(arguments.folder / "inputs.safetensors").items():
        batch, field = name.split(".")
        batches.setdefault(batch, {})[field] = tensor
    weights = [weight.requires_grad_() for weight in named.values()]
    adam = torch.optim.Adam(weights, lr=3e-4, fused=True)

    def forward(batch):
        with torch.inference_mode():
            return bind(spec, named, batches[batch])(batches[batch]["x"], batches[batch]["sigma"])

    def train(batch):
        adam.zero_grad()
        error = loss(bind(spec, named, batches[batch]), batches[batch])
        error.backward()
        torch.nn.utils.clip_grad_norm_(weights, 5.0)
        adam.step()

    def sample(n_futures, n_steps):
        with torch.inference_mode():
            bound = bind(spec, named, batches["scene"], int(n_futures))
            return heun(spec["edm"], bound, batches["scene"], int(n_futures), int(n_steps))

    save_file({"output": forward("0").contiguous()}, arguments.folder / "outputs.safetensors")
    print(f"PyTorch {torch.__version__}, {torch.get_num_threads()} threads, {torch.backends.cpu.get_cpu_capability()}", flush=True)
    for line in sys.stdin:
        name, *values = line.split()
        call = {"forward": forward, "train": train, "sample": sample}[name]
        wall, cpu = time.perf_counter(), time.process_time()
        call(*values)
        print(time.perf_counter() - wall, time.process_time() - cpu, flush=True)


if __name__ == "__main__":
    main()
