"""The passes of a frame: what each reads and writes, and under which name its time is measured.

A frame's plan (frame_plan.py) is a list of these; renderer.py runs them. docs/architecture.md shows this table.
"""

from typing import NamedTuple

# What a plan provides: no pass writes these.
INPUTS = ("lights", "near lights", "environment", "pose", "background", "plate", "uploaded picture", "previous adaptation", "exposure")
# What stays on the GPU after a frame: frame.FrameState describes it, so that a plan need not draw it again.
CACHED = (
    "luminaire maps", "shadow maps", "light frames", "G-buffer", "class depth", "cached visibility", "coarse surfaces", "coarse visibility",
    "edges", "near visibility",
)  # fmt: skip


class Pass(NamedTuple):
    """A pass. timer: the name under which its time is measured, the same for several passes that are measured together. module: the file
    below services/renderer/ that draws it."""

    name: str
    timer: str
    reads: tuple[str, ...]
    writes: tuple[str, ...]
    module: str


LUMINAIRE_MAPS = Pass("luminaire maps", "luminaire maps", ("pose",), ("luminaire maps",), "passes/luminaires/illumination.py")
SHADOW_MAPS = Pass(
    "shadow maps", "shadow maps", ("lights", "pose", "shadow maps"), ("light frames", "shadow maps"), "passes/shadow_maps/shadow_maps.py"
)
PREFILTER = Pass("prefilter", "gloss", ("lights", "environment"), ("prefiltered map",), "passes/gloss/prefiltered_map.py")
G_BUFFER = Pass("G-buffer", "G-buffer", ("pose",), ("G-buffer",), "passes/gbuffer/gbuffer.py")
CLASSES = Pass("classes", "classes", ("G-buffer",), ("class depth",), "passes/lights/shading.py")
EDGES = Pass("edges", "edges", ("pose", "G-buffer"), ("edges",), "passes/edges/edges.py")
EMISSION = Pass("emission", "emission", ("G-buffer",), ("picture",), "passes/emission/emission.py")
LUMINAIRES = Pass("luminaires", "luminaires", ("G-buffer", "luminaire maps"), ("picture", "matte"), "passes/luminaires/illumination.py")
VISIBILITY_CACHE = Pass(
    "visibility cache",
    "visibility cache",
    ("G-buffer", "class depth", "light frames", "shadow maps"),
    ("cached visibility",),
    "passes/lights/visibility_cache.py",
)
RAYS = Pass("rays", "rays", ("lights", "pose", "G-buffer"), ("light frames", "cached visibility"), "passes/lights/traced_visibility.py")
LIGHTS = Pass(
    "lights",
    "lights",
    ("G-buffer", "class depth", "light frames", "shadow maps", "cached visibility", "coarse surfaces", "coarse light"),
    ("picture", "matte", "lobe visibility"),
    "passes/lights/shading.py",
)
NEAR_RAYS = Pass("near rays", "rays", ("near lights", "pose", "G-buffer"), ("near visibility",), "passes/near_lights/near_lights.py")
NEAR_MAPS = Pass("near maps", "shadow maps", ("near lights", "pose"), ("near visibility",), "passes/near_lights/near_light_maps.py")
NEAR_LIGHTS = Pass(
    "near lights",
    "lights",
    ("near lights", "G-buffer", "class depth", "near visibility"),
    ("picture", "near matte"),
    "passes/near_lights/near_lights.py",
)
NEAR_MATTE = Pass("near matte", "lights", ("matte", "near matte"), ("picture", "matte"), "passes/near_lights/near_matte.py")
COARSE_SURFACES = Pass("coarse surfaces", "coarse surfaces", ("G-buffer",), ("coarse surfaces",), "passes/gbuffer/coarse_surfaces.py")
WEAK_RAYS = Pass(
    "weak rays", "rays", ("lights", "pose", "coarse surfaces"), ("light frames", "coarse visibility"), "passes/lights/traced_visibility.py"
)
WEAK_LIGHTS = Pass(
    "weak lights", "lights", ("coarse surfaces", "light frames", "coarse visibility"), ("coarse light",), "passes/lights/weak_lights.py"
)
WEAK_BOUNCE = Pass("weak bounce", "bounce", ("lights", "pose", "coarse surfaces"), ("coarse light", "matte"), "passes/bounce/bounce.py")
WEAK_GLOSS = Pass("weak gloss", "gloss", ("coarse surfaces", "prefiltered map"), ("coarse gloss",), "passes/gloss/gloss.py")
MIRRORS = Pass("mirrors", "mirrors", ("lights", "pose", "G-buffer"), ("picture", "mirrored scene"), "passes/mirrors/mirrors.py")
GLOSS = Pass(
    "gloss",
    "gloss",
    ("G-buffer", "lobe visibility", "prefiltered map", "coarse gloss", "mirrored scene"),
    ("picture",),
    "passes/gloss/gloss.py",
)
BOUNCE = Pass("bounce", "bounce", ("lights", "pose", "G-buffer"), ("picture", "matte"), "passes/bounce/bounce.py")
COMPOSITING = Pass(
    "compositing",
    "compositing",
    ("picture", "matte", "plate", "background"),
    ("picture",),
    "passes/background/compositing.py",
)
UPLOAD = Pass("upload", "upload", ("uploaded picture",), ("picture",), "renderer.py")
READ_BACK = Pass("read-back", "read-back", ("picture", "edges"), ("linear picture",), "renderer.py")
ADAPTATION = Pass("adaptation", "read-back", ("picture", "previous adaptation"), ("adaptation",), "passes/present/present.py")
TONE_MAPPING = Pass(
    "tone mapping", "tone mapping", ("picture", "edges", "adaptation", "exposure"), ("pixels",), "passes/present/present.py"
)

PASSES = (
    LUMINAIRE_MAPS, SHADOW_MAPS, PREFILTER, EDGES, G_BUFFER, COARSE_SURFACES, CLASSES, EMISSION, LUMINAIRES, VISIBILITY_CACHE,
    WEAK_RAYS, WEAK_LIGHTS, WEAK_BOUNCE, WEAK_GLOSS, RAYS, LIGHTS, NEAR_RAYS, NEAR_MAPS, NEAR_LIGHTS, MIRRORS, GLOSS, BOUNCE, NEAR_MATTE,
    COMPOSITING, UPLOAD, READ_BACK, ADAPTATION, TONE_MAPPING,
)  # fmt: skip
