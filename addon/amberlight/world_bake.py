# SPDX-License-Identifier: GPL-3.0-or-later
"""A world of any nodes as one image: Cycles evaluates them in all directions.

A panoramic camera looks at a copy of the world through a pane that does not bend light. So the
nodes answer as they do for light, not for the camera, wherever a Light Path tells the two apart.
"""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy

from .binding.errors import AmberlightError
from .engine import say
from .export.extract_world import has_nodes, is_understood
from .export.tree_fingerprint import fingerprint, widest_image

NAME = "Amberlight Bake"
WIDTHS = (2048, 8192)
# Most pixels of a sky take 16 samples; one on the edge of the sun takes all of these, or until its
# relative noise is so low (Blender 3: noise over the root), so that the sun keeps its watts: at a
# width of 2048 to 0.1 % (3.4) and 0.2 % (4.3, 5.2). Grainy images would take ten times as long for
# a third of that.
SAMPLES = 1024
NOISE = 0.01
CUBE = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def state_of(world: Any, frame: int) -> str:
    """NOT_NEEDED, MISSING, CURRENT or STALE."""
    if is_understood(world, bpy.app.version):
        return "NOT_NEEDED"
    settings = world.amberlight
    if settings.image is None:
        return "MISSING"
    return "CURRENT" if settings.fingerprint == fingerprint(world, frame) else "STALE"


def bake(scene: Any, world: Any, *, only_if_stale: bool = False) -> bool:
    """Leaves what the nodes of the world show at the scene's frame in world.amberlight; True if it
    did. AmberlightError where that cannot be."""
    if not has_nodes(world, bpy.app.version):
        raise AmberlightError(f'world "{world.name}" has no nodes to bake')
    if world.library or world.override_library:
        raise AmberlightError(f'world "{world.name}" is of another file: make it local to bake it')
    with _studio(scene, world) as studio:
        seen = studio.world.evaluated_get(studio.view_layers[0].depsgraph)
        key = fingerprint(seen, scene.frame_current)
        settings = world.amberlight
        if only_if_stale and settings.image is not None and settings.fingerprint == key:
            return False
        if bpy.app.background:
            say(f'baking world "{world.name}"')
        image = _picture(studio, _width(world))
    clear(world)
    image.name = f"{world.name} Baked"
    # Where it would be unpacked.
    image.filepath_raw = f"//{bpy.path.clean_name(image.name)}.exr"
    settings.image, settings.fingerprint = image, key
    return True


def clear(world: Any) -> None:
    image, world.amberlight.image = world.amberlight.image, None
    world.amberlight.fingerprint = ""
    if image is not None and image.users == 0:
        bpy.data.images.remove(image)


def _width(world: Any) -> int:
    low, high = WIDTHS
    return world.amberlight.width or min(max(widest_image(world), low), high)


@contextmanager
def _studio(scene: Any, world: Any) -> Iterator[Any]:
    """A scene with nothing but the world, the pane and the camera, at the same time."""
    made: list[tuple[Any, Any]] = []

    def make(kind: str, *arguments: Any) -> Any:
        blocks = getattr(bpy.data, kind)
        block = blocks.new(NAME, *arguments)
        made.append((blocks, block))
        return block

    try:
        studio = make("scenes")
        studio.world = world.copy()
        made.append((bpy.data.worlds, studio.world))
        _show_to_light(studio.world)
        camera = make("cameras")
        _look_everywhere(camera)
        stand = make("objects", camera)
        # The middle of a world image is +x, the top +z.
        stand.rotation_euler = (math.radians(90), 0, math.radians(-90))
        mesh = make("meshes")
        mesh.from_pydata(CUBE, [], SIDES)
        mesh.materials.append(_clear_pane(make("materials")))
        for thing in (stand, make("objects", mesh)):
            studio.collection.objects.link(thing)
        studio.camera = stand
        _set_up(studio, scene)
        studio.frame_set(scene.frame_current, subframe=scene.frame_subframe)
        yield studio
    finally:
        # The last first: nothing is removed that another still uses.
        for blocks, block in reversed(made):
            blocks.remove(block)


def _show_to_light(world: Any) -> None:
    """Rays of all kinds see it, and nothing is between."""
    for node in world.node_tree.nodes:
        if node.type == "OUTPUT_WORLD":
            for link in node.inputs["Volume"].links:
                world.node_tree.links.remove(link)
    visibility = getattr(world, "cycles_visibility", None)
    for name in ("camera", "transmission", "glossy"):
        if hasattr(visibility, name):
            setattr(visibility, name, True)
    if hasattr(getattr(world, "cycles", None), "sampling_method"):
        # Without a map of where its light is, which nothing here is lit by.
        world.cycles.sampling_method = "NONE"


def _look_everywhere(camera: Any) -> None:
    camera.type = "PANO"
    owner = camera if hasattr(camera, "panorama_type") else getattr(camera, "cycles", None)
    if owner is not None:
        owner.panorama_type = "EQUIRECTANGULAR"
    camera.clip_start = 1e-3


def _clear_pane(material: Any) -> Any:
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    pane = tree.nodes.new("ShaderNodeBsdfRefraction")
    pane.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    pane.inputs["Roughness"].default_value = 0.0
    pane.inputs["IOR"].default_value = 1.0
    tree.links.new(pane.outputs[0], output.inputs["Surface"])
    return material


def _set_up(studio: Any, scene: Any) -> None:
    """Cycles as it computes radiance, with nothing that makes it look better."""
    render = studio.render
    try:
        render.engine = "CYCLES"
    except TypeError:
        raise AmberlightError(
            "baking the world takes Blender's add-on Cycles Render Engine: enable it"
        ) from None
    render.resolution_percentage = 100
    render.use_border = render.use_compositing = render.use_sequencer = False
    render.threads_mode = scene.render.threads_mode
    if render.threads_mode == "FIXED":
        render.threads = scene.render.threads
    values = {
        "samples": SAMPLES,
        "use_adaptive_sampling": True,
        "adaptive_threshold": NOISE,
        "adaptive_min_samples": 4,
        "time_limit": 0.0,
        "use_denoising": False,
        "pixel_filter_type": "BOX",
        "sample_clamp_direct": 0.0,
        "sample_clamp_indirect": 0.0,
        "blur_glossy": 0.0,
        "film_exposure": 1.0,
        # Cycles looks for a break after 16 samples of a tile.
        "use_auto_tile": True,
        "tile_size": 512,
        "shading_system": getattr(scene.cycles, "shading_system", False),
    }
    for name, value in values.items():
        if hasattr(studio.cycles, name):
            setattr(studio.cycles, name, value)
    settings = render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "IMAGE"
    settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGB", "32"
    settings.exr_codec = "ZIP"


def _picture(studio: Any, width: int) -> Any:
    """Through a file: pixels that were set are packed without compression."""
    render = studio.render
    render.resolution_x, render.resolution_y = width, width // 2
    render.use_file_extension = False
    folder = tempfile.mkdtemp(dir=bpy.app.tempdir)
    try:
        file = Path(folder) / "world.exr"
        render.filepath = str(file)
        bpy.ops.render.render(scene=studio.name, write_still=True)
        if not file.is_file():
            raise AmberlightError("the world is not baked: cancelled")
        image = bpy.data.images.load(str(file))
        image.pack()
        return image
    except RuntimeError as error:
        raise AmberlightError(f"the world is not baked: {error}") from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@bpy.app.handlers.persistent
def bake_before_render(scene: Any, *_: Any) -> None:
    """Without a window nobody presses a button, and a render may begin another one."""
    if not bpy.app.background or scene.render.engine != "AMBERLIGHT":
        return
    try:
        world = scene.world
        if world is not None and not is_understood(world, bpy.app.version):
            bake(scene, world, only_if_stale=True)
    except AmberlightError as error:
        # The render goes on and names what it does not understand.
        say(str(error))


def register() -> None:
    bpy.app.handlers.render_pre.append(bake_before_render)


def unregister() -> None:
    bpy.app.handlers.render_pre.remove(bake_before_render)
