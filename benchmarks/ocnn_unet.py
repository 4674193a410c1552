"""Times ocnn's U-Net at the paper's widths and depth; run by `benchmarks.speed --ocnn-python`.

ocnn 2.3.3 imports torchvision, which torch 2.13 CPU environments rarely have in a matching version,
for a class that is not used here. A throw-away environment with a stand-in does:

    python -m venv --system-site-packages /tmp/ocnnenv       # from an environment that has torch
    /tmp/ocnnenv/bin/pip install --no-deps ocnn==2.3.3
    packages=$(/tmp/ocnnenv/bin/python -c "import site; print(site.getsitepackages()[0])")
    mkdir -p $packages/torchvision/models && touch $packages/torchvision/__init__.py
    echo "resnet18 = None" > $packages/torchvision/models/__init__.py

If the first line is run from a virtual environment, the new one sees the system's packages and not
that environment's; name the latter's site-packages folder in `$packages/base.pth` then.
"""

from __future__ import annotations

import argparse
import json

import numpy as np
import torch

from benchmarks.measure import median_seconds


class PaperUNet:
    """ocnn's U-Net with the channels and blocks of appendix B, from points to leaf embeddings."""

    def __init__(self, depth: int) -> None:
        import ocnn

        class UNet(ocnn.models.UNet):
            def config_network(self) -> None:
                self.encoder_channel, self.encoder_blocks = [64, 64, 64, 128], [2, 3, 3]
                self.decoder_channel, self.decoder_blocks = [128] * 4, [2, 2, 2]
                self.head_channel, self.bottleneck = 128, 1
                self.resblk = ocnn.modules.OctreeResBlock2

        self.ocnn, self.depth = ocnn, depth
        self.net = UNet(in_channels=4, out_channels=256, nempty=True).eval()

    def __call__(self, points: torch.Tensor) -> torch.Tensor:
        octree = self.ocnn.octree.Octree(self.depth, full_depth=2)
        octree.build_octree(self.ocnn.octree.Points(points, torch.zeros_like(points)))
        octree.construct_all_neigh()
        features = octree.get_input_feature("LD", nempty=True)
        return self.net(features, octree, self.depth)


def main() -> None:
    """The command: prints the median seconds and the number of leaves as JSON."""
    parser = argparse.ArgumentParser(description="Seconds of ocnn's U-Net on a cloud.")
    parser.add_argument("points", help=".npy file, (N, 3) float32 in the cube")
    parser.add_argument("--depth", type=int, default=6)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    points = torch.from_numpy(np.load(options.points))
    unet = PaperUNet(options.depth)
    with torch.inference_mode():
        leaves = len(unet(points))
        seconds = median_seconds(lambda: unet(points), options.repeats)
    print(json.dumps({"seconds": seconds, "leaves": leaves}))


if __name__ == "__main__":
    main()
