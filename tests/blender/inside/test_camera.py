# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras: where points land in the image, against Blender's own answer."""

import random

import bpy
import numpy as np
import pytest
from amberlight.binding.errors import AmberlightError
from amberlight.export.conventions import projection_window
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Euler, Vector

CUBE = [Vector((x, y, z)) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]


def randomise(rng, camera, scene):
    data, render = camera.data, scene.render
    data.type = rng.choice(["PERSP", "ORTHO"])
    data.sensor_fit = rng.choice(["AUTO", "HORIZONTAL", "VERTICAL"])
    data.lens = rng.uniform(20, 120)
    data.ortho_scale = rng.uniform(2, 8)
    data.sensor_width, data.sensor_height = rng.uniform(10, 50), rng.uniform(10, 50)
    data.shift_x, data.shift_y = rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5)
    render.resolution_x, render.resolution_y = rng.randint(16, 256), rng.randint(16, 256)
    render.pixel_aspect_x, render.pixel_aspect_y = rng.choice([(1, 1), (2, 1), (1, 1.5)])
    distance = rng.uniform(5, 10)
    camera.rotation_euler = Euler([rng.uniform(-3, 3) for _ in range(3)])
    axis = camera.rotation_euler.to_matrix().col[2]
    camera.location = axis * distance
    camera.scale = [rng.choice([1.0, 0.5, 3.0])] * 3


def project(camera, point, width, height):
    """Pixels, y upwards, of a point seen by a CameraData."""
    world = np.array(camera.to_world)
    x, y, z = world[:3, :3].T @ (np.array(point) - world[:3, 3])
    if not camera.is_orthographic:
        x, y = x / -z, y / -z
    left, right, bottom, top = camera.window
    return width * (x - left) / (right - left), height * (y - bottom) / (top - bottom)


def blender_view(scene, camera, point):
    """world_to_camera_view in double: Blender's own rounding reaches 3e-4 of a pixel here."""
    world = np.array(camera.matrix_world.normalized())
    x, y, z = world[:3, :3].T @ (np.array(point) - world[:3, 3])
    frame = np.array([corner for corner in camera.data.view_frame(scene=scene)[:3]])
    if camera.data.type != "ORTHO":
        frame *= (z / frame[:, 2])[:, None]
    low, high = frame[1], frame[2]
    return (x - high[0]) / (low[0] - high[0]), (y - low[1]) / (frame[0][1] - low[1])


def test_points_land_where_blender_says(camera, scene, export):
    rng = random.Random(3)
    worst = worst_single = worst_window = 0.0
    for _ in range(200):
        randomise(rng, camera, scene)
        bpy.context.view_layer.update()
        data = export(with_camera=True)[0].camera
        render = scene.render
        size = np.array([render.resolution_x, render.resolution_y])
        for point in CUBE:
            got = project(data, point, *size)
            want = size * blender_view(scene, camera, point)
            worst = max(worst, *abs(got - want))
            single = size * world_to_camera_view(scene, camera, point).xy
            worst_single = max(worst_single, *abs(got - single))
        matrix = camera.calc_matrix_camera(
            bpy.context.evaluated_depsgraph_get(), x=size[0], y=size[1],
            scale_x=render.pixel_aspect_x, scale_y=render.pixel_aspect_y,
        )  # fmt: skip
        window = projection_window(matrix, data.is_orthographic)
        error = np.abs(np.subtract(window, data.window)).max() / max(map(abs, window))
        worst_window = max(worst_window, error)
    assert worst < 1e-4
    assert worst_single < 1e-3
    assert worst_window < 1e-5


def test_scale_is_removed(camera, export):
    camera.scale = (3, 3, 3)
    world = np.array(export(with_camera=True)[0].camera.to_world)
    assert np.linalg.det(world[:3, :3]) == pytest.approx(1.0, abs=1e-6)


def test_clip(camera, export):
    camera.data.clip_start, camera.data.clip_end = 0.5, 50
    data = export(with_camera=True)[0].camera
    assert (data.clip_start, data.clip_end) == (0.5, 50)


def test_depth_of_field(camera, export, add_mesh):
    assert export(with_camera=True)[0].camera.lens_radius == 0
    dof = camera.data.dof
    dof.use_dof, dof.aperture_fstop, dof.focus_distance = True, 2.0, 3.0
    data = export(with_camera=True)[0].camera
    assert data.lens_radius == pytest.approx(0.0125)
    assert data.focus_distance == pytest.approx(3.0)
    # The object counts by its distance along the view axis.
    target = add_mesh("Target", [(0, 0, 0)], [])
    target.location = (7, 2, 0)
    dof.focus_object = target
    assert export(with_camera=True)[0].camera.focus_distance == pytest.approx(7.0)


def test_aperture_that_is_not_round_is_named(camera, export):
    camera.data.dof.use_dof, camera.data.dof.aperture_blades = True, 6
    assert export(with_camera=True)[1] == ['the aperture is rendered as round: camera "Camera"']


def test_no_camera(export):
    with pytest.raises(AmberlightError, match="no camera"):
        export(with_camera=True)


def test_camera_that_is_none(scene, export, add_mesh):
    scene.camera = add_mesh("Quad", [(0, 0, 0)], [])
    with pytest.raises(AmberlightError, match='"Quad" cannot be the camera'):
        export(with_camera=True)


def test_panorama(camera, export):
    camera.data.type = "PANO"
    with pytest.raises(AmberlightError, match="perspective and orthographic"):
        export(with_camera=True)
