"""Configurations: three frozen dataclasses and the presets."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

BACKBONES = ("octree", "pointnet")
SCALES, WALKS = 3, 4
"""Most walks over planes, and most walks: the last one is on a shell."""
DECODERS = ("triplane", "siren")
LAYERS = 3
"""Linear layers of a decoder (appendix B)."""


@dataclass(frozen=True)
class BackboneConfig:
    """Octree and U-Net (Sec. 3.1, appendix B)."""

    depth: int = 5
    """Octree depth of the leaves: 2^depth cells along the cube."""
    stem: int = 64
    """Width of the point stem; 0 for the paper's plain leaf offsets."""
    encoder: tuple[int, ...] = (64, 96, 128, 128)
    """Channels at the leaves and after each halving."""
    encoder_blocks: tuple[int, ...] = (2, 3, 3)
    """Residual blocks after each halving."""
    decoder: tuple[int, ...] = (128, 128, 128, 96)
    """Channels at the coarsest level and after each doubling."""
    decoder_blocks: tuple[int, ...] = (2, 2, 2)
    """Residual blocks after each doubling."""
    embedding: int = 256
    """C, channels of the embedding z."""
    normals: bool = False
    """Whether the point stem is told the points' oriented normals (ours)."""
    kind: str = "octree"
    """`octree`: the U-Net. `pointnet` (Tab. 5): MLPs per point, `encoder` wide before the pool over
    the cloud and `decoder` wide after it; it has neither stem nor blocks."""

    def __post_init__(self) -> None:
        if self.kind not in BACKBONES:
            raise ValueError(f"kind must be one of {BACKBONES}, got {self.kind!r}")
        if self.normals and (self.kind != "octree" or not self.stem):
            raise ValueError("normals are told to the point stem: set kind='octree' and stem > 0")
        stages = len(self.encoder) - 1
        if not (len(self.decoder) - 1 == stages == len(self.encoder_blocks)):
            raise ValueError(
                f"encoder {self.encoder}, decoder {self.decoder} and encoder_blocks "
                f"{self.encoder_blocks} must describe the same number of stages"
            )
        if len(self.decoder_blocks) != stages:
            raise ValueError(
                f"decoder_blocks must have {stages} entries, got {self.decoder_blocks}"
            )
        if not stages <= self.depth <= 10:
            raise ValueError(
                f"depth must lie in [{stages}, 10] (one level a stage), got {self.depth}"
            )


@dataclass(frozen=True)
class HeadConfig:
    """Triplane hypernetworks and what their decoders are told (Sec. 3.2, appendix B)."""

    resolution: int = 16
    """R, cells along a plane."""
    channels: int = 8
    """Channels of a plane."""
    hidden: int = 128
    """Width of the decoder; the paper's is 256."""
    anchored: bool = True
    """Anchored residual maps, exact at the source (ours); False: the paper's plain decoder."""
    narrow: int = 32
    """Channels of the narrow embedding that is read at end points; 0: none, as in the paper."""
    walks: int = 4
    """Walks that both maps start from, up to four: over planes half as large as the leaves, a
    quarter as large, and as large; on the shell that a source beside the cloud lies on; 0: straight
    (q = p + v), as in the paper."""
    walk_steps: int = 14
    """Steps of the walks over planes, which are taken together; on a shell twice as many."""
    fan_rays: int = 48
    """Geodesics of each fan that Log starts from, one fan a walk of Exp, which answer as one over
    planes; 0: chords alone."""
    decoder: str = "triplane"
    """`triplane`, or `siren` (Tab. 5): a modulated sine network, without planes."""

    def __post_init__(self) -> None:
        if self.decoder not in DECODERS:
            raise ValueError(f"decoder must be one of {DECODERS}, got {self.decoder!r}")
        if not self.anchored and (self.narrow or self.walks):
            raise ValueError("narrow and walks refine the anchored maps: set anchored=True")
        if self.fan_rays < 0 or self.fan_rays in (1, 2):
            raise ValueError(f"fan_rays must be 0 or at least 3, got {self.fan_rays}")
        if self.walks not in range(WALKS + 1):
            raise ValueError(f"walks must be an integer in [0, {WALKS}], got {self.walks!r}")
        steps = self.walk_steps
        if not isinstance(steps, int) or steps < 1:
            raise ValueError(f"walk_steps must be an integer of at least 1, got {steps!r}")


@dataclass(frozen=True)
class FieldConfig:
    """The whole field."""

    backbone: BackboneConfig = field(default_factory=BackboneConfig)
    head: HeadConfig = field(default_factory=HeadConfig)
    radius: float = 0.5
    """Trained tangent radius, in the normalised cube [-1, 1]^3."""

    @classmethod
    def base(cls) -> FieldConfig:
        """What the package ships."""
        return cls()

    @classmethod
    def base_normals(cls) -> FieldConfig:
        """`base` for clouds with oriented normals, which tell the sides of a thin sheet apart."""
        return cls(BackboneConfig(normals=True))

    @classmethod
    def paper(cls) -> FieldConfig:
        """Appendix B to the letter: depth 6, no point stem, no anchor, no prior, no refinement."""
        backbone = BackboneConfig(
            depth=6, stem=0, encoder=(64, 64, 64, 128), decoder=(128, 128, 128, 128)
        )
        return cls(
            backbone,
            HeadConfig(hidden=256, anchored=False, narrow=0, walks=0),
        )

    @classmethod
    def tiny(cls) -> FieldConfig:
        """For tests and examples: trains and answers in under a second on a processor."""
        backbone = BackboneConfig(
            depth=4,
            stem=16,
            encoder=(16, 16, 32),
            encoder_blocks=(1, 1),
            decoder=(32, 32, 32),
            decoder_blocks=(1, 1),
            embedding=48,
        )
        return cls(
            backbone,
            HeadConfig(
                resolution=8,
                channels=4,
                hidden=48,
                narrow=8,
                walk_steps=8,
                fan_rays=12,
            ),
        )

    @classmethod
    def preset(cls, name: str) -> FieldConfig:
        """The configuration called `base`, `base-normals`, `paper` or `tiny`."""
        presets = {
            "base": cls.base,
            "base-normals": cls.base_normals,
            "paper": cls.paper,
            "tiny": cls.tiny,
        }
        if name not in presets:
            raise ValueError(f"preset must be one of {sorted(presets)}, got {name!r}")
        return presets[name]()

    def to_dict(self) -> dict:
        """As plain numbers and lists, for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict) -> FieldConfig:
        """Inverse of `to_dict`; unknown names raise."""
        try:
            rest = {k: v for k, v in values.items() if k not in ("backbone", "head")}
            backbone = BackboneConfig(**_tuples(values["backbone"]))
            return cls(backbone=backbone, head=HeadConfig(**values["head"]), **rest)
        except (AttributeError, KeyError, TypeError) as error:
            raise ValueError(f"not the configuration of an ExpLogField: {error}") from error


def _tuples(values: dict) -> dict[str, Any]:
    """As JSON holds them, with tuples for lists."""
    return {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
