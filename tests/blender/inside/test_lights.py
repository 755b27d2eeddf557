# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights and world against the units measured in Cycles."""

import math

import bpy
import pytest

VERSION = bpy.app.version


@pytest.fixture
def add_light(scene):
    def add(kind, **settings):
        data = bpy.data.lights.new("Lamp", kind)
        for name, value in settings.items():
            setattr(data, name, value)
        thing = bpy.data.objects.new("Lamp", data)
        scene.collection.objects.link(thing)
        return thing

    return add


def only_light(export):
    data, lines = export()
    assert lines == []
    (light,) = data.lights
    return light


def test_point(add_light, export):
    add_light("POINT", energy=100, color=(1, 0.5, 0), shadow_soft_size=0.25).location = (1, 2, 3)
    light = only_light(export)
    assert light.kind == "POINT" and light.name == "Lamp"
    assert light.color == pytest.approx((7.957747, 3.978873, 0))
    assert light.position == (1, 2, 3) and light.radius == 0.25


def test_spot(add_light, export):
    lamp = add_light("SPOT", energy=100, spot_size=1.0, spot_blend=0.5, shadow_soft_size=0)
    lamp.rotation_euler = (0, math.radians(90), 0)
    light = only_light(export)
    # On the axis like a point light, whatever the cone.
    assert light.color == pytest.approx((7.957747,) * 3)
    assert light.direction == pytest.approx((-1, 0, 0), abs=1e-6)
    assert (light.spot_size, light.spot_blend) == pytest.approx((1.0, 0.5))
    assert light.spot_cosine == (1.0 if VERSION < (3, 6) else 0.0)


def test_sun(add_light, export):
    add_light("SUN", energy=3, angle=0.1)
    light = only_light(export)
    assert light.kind == "SUN" and light.color == (3, 3, 3)
    assert light.direction == (0, 0, -1) and light.angle == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("shape", "extent", "area"),
    [
        ("SQUARE", (1, 1), 1.0),
        ("RECTANGLE", (1, 0.5), 0.5),
        ("DISK", (1, 1), math.pi / 4),
        ("ELLIPSE", (1, 0.5), math.pi / 8),
    ],
)
def test_area(add_light, export, shape, extent, area):
    lamp = add_light("AREA", energy=100, shape=shape, size=1, size_y=0.5)
    light = only_light(export)
    factor = 4 if VERSION < (4, 0) else math.pi
    assert light.color == pytest.approx((100 / (factor * area),) * 3)
    assert light.size == pytest.approx(extent)
    assert light.is_ellipse == (shape in {"DISK", "ELLIPSE"})
    # Scale makes it larger, not brighter in sum.
    lamp.scale = (2, 3, 1)
    light = only_light(export)
    assert light.size == pytest.approx((2 * extent[0], 3 * extent[1]))
    assert light.color == pytest.approx((100 / (factor * area * 6),) * 3)


def test_area_spread_is_named(add_light, export):
    add_light("AREA", spread=1.0)
    assert export()[1] == ['the spread of an area light is ignored: light "Lamp"']


RAYS = ("diffuse", "glossy", "transmission", "volume_scatter")


@pytest.mark.parametrize("rays", RAYS)
def test_hidden_lights_are_named(add_light, export, rays):
    setattr(add_light("POINT"), f"visible_{rays}", False)
    assert export()[1] == ['the ray visibility of lights is ignored: light "Lamp"']


def test_lights_without_shadows_are_named(add_light, export):
    lamp = add_light("POINT")
    if not hasattr(getattr(lamp.data, "cycles", None), "cast_shadow"):
        pytest.skip("no Cycles")
    lamp.data.cycles.cast_shadow = False
    assert export()[1] == ['a light without shadows casts them: light "Lamp"']


def test_portal_is_left_out(add_light, export):
    lamp = add_light("AREA")
    if not hasattr(lamp.data, "cycles"):
        pytest.skip("no Cycles")
    lamp.data.cycles.is_portal = True
    data, lines = export()
    assert data.lights == [] and "portal" in lines[0]


@pytest.mark.skipif(VERSION < (4, 5), reason="newer settings")
def test_newer_settings(add_light, export):
    add_light("POINT", energy=100, exposure=1.0, normalize=False, shadow_soft_size=0.5)
    assert only_light(export).color == pytest.approx((2 * 7.957747 * math.pi,) * 3)


def test_nodes_multiply(add_light, export):
    lamp = add_light("SUN", energy=2)
    lamp.data.use_nodes = True
    emission = lamp.data.node_tree.nodes["Emission"]
    emission.inputs["Strength"].default_value = 3
    emission.inputs["Color"].default_value = (1, 0.5, 0, 1)
    assert only_light(export).color == pytest.approx((6, 3, 0))
    texture = lamp.data.node_tree.nodes.new("ShaderNodeTexNoise")
    lamp.data.node_tree.links.new(texture.outputs[1], emission.inputs["Color"])
    data, lines = export()
    assert data.lights[0].color == pytest.approx((6, 3, 0))
    assert lines == [
        'input "Color" is not a constant, its own value is used: light "Lamp", node "Emission"'
    ]


def test_dark_and_negative_lights(add_light, export):
    add_light("POINT", energy=0)
    add_light("POINT", energy=-5)
    data, lines = export()
    assert data.lights == []
    assert lines == ['a light of negative power is left out: light "Lamp.001"']


def test_no_world(export):
    assert export()[0].world == (0, 0, 0)


def test_world(scene, export):
    world = scene.world = bpy.data.worlds.new("World")
    if VERSION < (5, 0):
        world.use_nodes = False
        world.color = (0.1, 0.2, 0.3)
        assert export()[0].world == pytest.approx((0.1, 0.2, 0.3))
        world.use_nodes = True
    background = world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (0.5, 0.25, 1, 1)
    background.inputs["Strength"].default_value = 2
    assert export()[0].world == pytest.approx((1, 0.5, 2))
    sky = world.node_tree.nodes.new("ShaderNodeTexSky")
    world.node_tree.links.new(sky.outputs[0], background.inputs["Color"])
    data, lines = export()
    assert data.world == pytest.approx((1, 0.5, 2))
    assert lines == [
        'input "Color" is not a constant, its own value is used: world "World", node "Background"',
        "Bake World (World properties) lets Cycles evaluate nodes that are not understood: "
        'world "World"',
    ]
