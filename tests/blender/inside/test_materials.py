# SPDX-License-Identifier: GPL-3.0-or-later
"""Node trees against what Cycles makes of them."""

import bpy
import pytest
from amberlight.binding.errors import AmberlightError
from amberlight.export import node_tree

OLD = bpy.app.version < (4, 0)
TRANSMISSION = "Transmission" if OLD else "Transmission Weight"
SUBSURFACE = "Subsurface" if OLD else "Subsurface Weight"
EMISSION = "Emission" if OLD else "Emission Color"


class Tree:
    """Builds a material on a triangle: tree.add(type, Input=value), tree.link(node, node, name)."""

    def __init__(self, scene, export):
        mesh = bpy.data.meshes.new("Thing")
        mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
        self.material = bpy.data.materials.new("Goo")
        if bpy.app.version < (5, 0):
            self.material.use_nodes = True
        mesh.materials.append(self.material)
        scene.collection.objects.link(bpy.data.objects.new("Thing", mesh))
        self.tree = self.material.node_tree
        self.tree.nodes.clear()
        self.output = self.add("OutputMaterial")
        self.export = export

    def add(self, kind, tree=None, **inputs):
        node = (tree or self.tree).nodes.new(f"ShaderNode{kind}")
        for name, value in inputs.items():
            self.set(node, name.replace("_", " "), value)
        return node

    @staticmethod
    def set(node, name, value):
        # The factor of Mix Shader has another name in newer versions.
        if name == "Fac":
            name = node.inputs[0].name
        if isinstance(value, tuple) and node.inputs[name].type == "RGBA":
            value = (*value, 1.0)
        node.inputs[name].default_value = value

    def link(self, a, b, name, tree=None):
        (tree or self.tree).links.new(a.outputs[0], b.inputs[name])
        return b

    def surface(self, node):
        self.link(node, self.output, "Surface")

    def volume(self, node):
        self.link(node, self.output, "Volume")

    def glass(self):
        self.surface(self.add("BsdfGlass", Color=(1.0, 1.0, 1.0), Roughness=0.0, IOR=1.5))

    def read(self):
        data, lines = self.export()
        return data.materials[data.objects[0].materials[0]], lines


@pytest.fixture
def goo(scene, export):
    return Tree(scene, export)


def where(node):
    return f'object "Thing", material "Goo", node "{node}"'


# ---- Surfaces ------------------------------------------------------------------------------------


def test_glass(goo):
    goo.surface(goo.add("BsdfGlass", Color=(0.9, 0.5, 0.1), Roughness=0.0, IOR=1.33))
    material, lines = goo.read()
    assert lines == [] and material.name == "Goo" and material.is_dielectric
    assert material.ior == pytest.approx(1.33)
    # Every crossing and every reflection is tinted.
    assert material.transmit_color == material.reflect_color == pytest.approx((0.9, 0.5, 0.1))
    assert material.medium.lobes == () and material.medium.sigma_a == (0, 0, 0)


def test_rough_glass_is_named(goo):
    glass = goo.add("BsdfGlass", Roughness=0.2)
    glass.distribution = "BECKMANN"
    goo.surface(glass)
    material, lines = goo.read()
    assert material.is_dielectric
    assert lines == [f"a rough refractive surface is rendered as smooth: {where('Glass BSDF')}"]


@pytest.mark.skipif(not OLD, reason="SHARP is gone")
def test_sharp_glass_has_no_roughness(goo):
    glass = goo.add("BsdfGlass", Roughness=0.2)
    glass.distribution = "SHARP"
    goo.surface(glass)
    assert goo.read()[1] == []


def test_refraction_reflects_nothing(goo):
    goo.surface(goo.add("BsdfRefraction", Color=(1.0, 1.0, 1.0), Roughness=0.0, IOR=1.4))
    material, lines = goo.read()
    assert lines == [] and material.is_dielectric
    assert material.reflect_color == (0, 0, 0) and material.transmit_color == (1, 1, 1)


def test_principled_transmission(goo):
    node = goo.add("BsdfPrincipled", Base_Color=(0.64, 1.0, 0.25), Roughness=0.0, IOR=1.45)
    goo.set(node, TRANSMISSION, 1.0)
    goo.surface(node)
    material, lines = goo.read()
    assert lines == [] and material.is_dielectric and material.ior == pytest.approx(1.45)
    tint = (0.64, 1.0, 0.25) if OLD else (0.8, 1.0, 0.5)
    assert material.transmit_color == pytest.approx(tint)
    assert material.reflect_color == (1, 1, 1)


def test_principled_options_are_named(goo):
    node = goo.add("BsdfPrincipled", Roughness=0.3, Metallic=0.5, Alpha=0.5)
    goo.set(node, TRANSMISSION, 0.75)
    goo.set(node, SUBSURFACE, 0.5)
    goo.surface(node)
    material, lines = goo.read()
    assert material.is_dielectric
    assert sorted(line.split(":")[0] for line in lines) == [
        "a rough refractive surface is rendered as smooth",
        "alpha is ignored",
        "metallic reflection is ignored",
        "partial transmission is rendered as all transmission",
        "subsurface scattering of the surface is ignored",
    ]


def test_principled_opaque(goo):
    node = goo.add("BsdfPrincipled", Base_Color=(0.1, 0.2, 0.3), Emission_Strength=2.0)
    goo.set(node, EMISSION, (1.0, 0.5, 0.0))
    goo.surface(node)
    material, lines = goo.read()
    assert not material.is_dielectric
    assert material.albedo == pytest.approx((0.1, 0.2, 0.3))
    assert material.emission == pytest.approx((2, 1, 0))
    assert lines == []


def test_default_principled_says_nothing(goo):
    goo.surface(goo.add("BsdfPrincipled"))
    assert goo.read()[1] == []


def test_diffuse(goo):
    goo.surface(goo.add("BsdfDiffuse", Color=(0.1, 0.2, 0.3)))
    material, lines = goo.read()
    assert lines == [] and material.albedo == pytest.approx((0.1, 0.2, 0.3))


def test_transparent_is_a_clear_boundary(goo):
    goo.surface(goo.add("BsdfTransparent", Color=(0.5, 1.0, 1.0)))
    goo.volume(goo.add("VolumeScatter"))
    material, lines = goo.read()
    assert lines == [] and material.is_dielectric and material.ior == 1
    assert material.transmit_color == pytest.approx((0.5, 1, 1))


def test_volume_alone_has_no_boundary(goo):
    goo.volume(goo.add("VolumeScatter", Density=2.0))
    material, lines = goo.read()
    assert lines == [] and material.is_dielectric and material.ior == 1
    assert material.transmit_color == material.reflect_color == (1, 1, 1)
    assert len(material.medium.lobes) == 1


def test_nothing_connected(goo):
    material, lines = goo.read()
    assert material.albedo == (0, 0, 0) and "nothing that is understood" in lines[0]
    goo.tree.nodes.clear()
    material, lines = goo.read()
    assert lines == [
        'the material has no output node, it is rendered black: object "Thing", material "Goo"'
    ]


def test_mix_of_lambertians_is_exact(goo):
    mix = goo.add("MixShader", Fac=0.25)
    goo.tree.links.new(goo.add("BsdfDiffuse", Color=(1.0, 0.0, 0.0)).outputs[0], mix.inputs[1])
    goo.tree.links.new(goo.add("BsdfDiffuse", Color=(0.0, 1.0, 0.0)).outputs[0], mix.inputs[2])
    goo.surface(mix)
    material, lines = goo.read()
    assert lines == [] and material.albedo == pytest.approx((0.75, 0.25, 0))


def test_mix_keeps_the_refractive_part(goo):
    mix = goo.add("MixShader", Fac=0.9)
    goo.tree.links.new(goo.add("BsdfGlass", Roughness=0.0).outputs[0], mix.inputs[1])
    goo.tree.links.new(goo.add("BsdfTransparent").outputs[0], mix.inputs[2])
    goo.surface(mix)
    material, lines = goo.read()
    assert material.is_dielectric and material.ior > 1
    assert lines == [
        "alone stands for a mix of surfaces, without Transparent BSDF: " + where("Glass BSDF")
    ]


def test_mix_at_its_ends_is_no_mix(goo):
    mix = goo.add("MixShader", Fac=1.0)
    goo.tree.links.new(goo.add("BsdfGlass", Roughness=0.0).outputs[0], mix.inputs[1])
    goo.tree.links.new(goo.add("BsdfDiffuse").outputs[0], mix.inputs[2])
    goo.surface(mix)
    material, lines = goo.read()
    assert lines == [] and not material.is_dielectric


def test_unknown_surface_is_named(goo):
    goo.surface(goo.add("BsdfTranslucent", Color=(0.1, 0.2, 0.3)))
    material, lines = goo.read()
    assert material.albedo == pytest.approx((0.1, 0.2, 0.3))
    assert lines == [
        "Translucent BSDF is not understood, rendered as diffuse: " + where("Translucent BSDF")
    ]


def test_normal_map_and_displacement_are_named(goo):
    glass = goo.add("BsdfGlass", Roughness=0.0)
    goo.link(goo.add("Bump"), glass, "Normal")
    goo.surface(glass)
    goo.link(goo.add("Displacement"), goo.output, "Displacement")
    assert goo.read()[1] == [
        "displacement is ignored: " + where("Material Output"),
        'input "Normal" is ignored: ' + where("Glass BSDF"),
    ]


def test_tint_above_one_is_limited(goo):
    goo.surface(goo.add("BsdfGlass", Color=(2.0, 1.0, 1.0), Roughness=0.0))
    material, lines = goo.read()
    assert material.transmit_color == (1, 1, 1) and "limited" in lines[0]


@pytest.mark.skipif(bpy.app.version >= (5, 0), reason="nodes always")
def test_without_nodes(goo):
    goo.material.use_nodes = False
    goo.material.diffuse_color = (0.1, 0.2, 0.3, 1)
    assert goo.read()[0].albedo == pytest.approx((0.1, 0.2, 0.3))


# ---- Volumes -------------------------------------------------------------------------------------


def medium(goo, node):
    goo.glass()
    goo.volume(node)
    material, lines = goo.read()
    return material.medium, lines


def test_scatter(goo):
    node = goo.add("VolumeScatter", Color=(0.5, 1.0, 0.0), Density=2.0, Anisotropy=0.9)
    got, lines = medium(goo, node)
    assert lines == [] and got.sigma_a == (0, 0, 0)
    (lobe,) = got.lobes
    assert lobe.sigma_s == pytest.approx((1, 2, 0)) and lobe.g == pytest.approx(0.9)


def test_absorption(goo):
    got, lines = medium(goo, goo.add("VolumeAbsorption", Color=(0.5, 1.0, 0.0), Density=2.0))
    assert lines == [] and got.lobes == () and got.sigma_a == pytest.approx((1, 0, 2))


def test_principled_volume(goo):
    node = goo.add("VolumePrincipled", Color=(0.5, 0.5, 1.0), Density=2.0, Anisotropy=-0.3)
    goo.set(node, "Absorption Color", (0.0, 0.25, 0.0))
    got, lines = medium(goo, node)
    assert lines == [] and got.sigma_a == pytest.approx((1, 0.5, 0))
    assert got.lobes[0].sigma_s == pytest.approx((1, 1, 2))
    assert got.lobes[0].g == pytest.approx(-0.3)


@pytest.mark.skipif(not hasattr(bpy.types, "ShaderNodeVolumeCoefficients"), reason="no such node")
def test_volume_coefficients(goo):
    node = goo.add("VolumeCoefficients", Anisotropy=0.5)
    goo.set(node, "Absorption Coefficients", (0.1, 0.2, 0.3))
    goo.set(node, "Scatter Coefficients", (1.0, 2.0, 3.0))
    got, lines = medium(goo, node)
    assert lines == [] and got.sigma_a == pytest.approx((0.1, 0.2, 0.3))
    assert got.lobes[0].sigma_s == pytest.approx((1, 2, 3))


def test_add_and_mix(goo):
    """Mix weighs the densities, Add sums; equal anisotropies are one lobe."""
    mix = goo.add("MixShader", Fac=0.25)
    thin = goo.add("VolumeScatter", Color=(1.0, 1.0, 1.0), Density=4.0, Anisotropy=0.5)
    thick = goo.add("VolumeScatter", Color=(1.0, 1.0, 1.0), Density=8.0, Anisotropy=0.5)
    goo.tree.links.new(thin.outputs[0], mix.inputs[1])
    goo.tree.links.new(thick.outputs[0], mix.inputs[2])
    both = goo.add("AddShader")
    absorb = goo.add("VolumeAbsorption", Color=(0.0, 0.0, 0.0), Density=1.0)
    goo.tree.links.new(mix.outputs[0], both.inputs[0])
    goo.tree.links.new(absorb.outputs[0], both.inputs[1])
    got, lines = medium(goo, both)
    assert lines == [] and got.sigma_a == (1, 1, 1)
    assert [lobe.sigma_s for lobe in got.lobes] == [pytest.approx((5, 5, 5))]


def test_two_lobes(goo):
    both = goo.add("AddShader")
    for index, g in enumerate((0.9, -0.2)):
        node = goo.add("VolumeScatter", Color=(1.0, 1.0, 1.0), Density=1.0, Anisotropy=g)
        goo.tree.links.new(node.outputs[0], both.inputs[index])
    got, lines = medium(goo, both)
    assert lines == [] and [lobe.g for lobe in got.lobes] == pytest.approx([-0.2, 0.9])


def test_more_than_four_lobes_are_merged_and_named(goo):
    total = None
    for g in (0.0, 0.1, 0.3, 0.6, 0.9):
        node = goo.add("VolumeScatter", Color=(1.0, 1.0, 1.0), Density=1.0, Anisotropy=g)
        if total is None:
            total = node
            continue
        both = goo.add("AddShader")
        goo.tree.links.new(total.outputs[0], both.inputs[0])
        goo.tree.links.new(node.outputs[0], both.inputs[1])
        total = both
    got, lines = medium(goo, total)
    assert len(got.lobes) == 4 and "more than 4 anisotropies" in lines[0]
    assert sum(lobe.sigma_s[0] for lobe in got.lobes) == pytest.approx(5)


def test_groups_reroutes_and_muted_nodes(goo):
    """A group with a density input, behind a reroute, around a muted Mix."""
    group = bpy.data.node_groups.new("Medium", "ShaderNodeTree")
    if hasattr(group, "interface"):
        group.interface.new_socket("Density", in_out="INPUT", socket_type="NodeSocketFloat")
        group.interface.new_socket("Volume", in_out="OUTPUT", socket_type="NodeSocketShader")
    else:
        group.inputs.new("NodeSocketFloat", "Density")
        group.outputs.new("NodeSocketShader", "Volume")
    begin, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    scatter = goo.add("VolumeScatter", tree=group, Color=(1.0, 1.0, 1.0), Anisotropy=0.25)
    double = group.nodes.new("ShaderNodeMath")
    double.operation, double.inputs[1].default_value = "MULTIPLY", 2.0
    group.links.new(begin.outputs[0], double.inputs[0])
    group.links.new(double.outputs[0], scatter.inputs["Density"])
    group.links.new(scatter.outputs[0], end.inputs[0])
    inner = goo.tree.nodes.new("ShaderNodeGroup")
    inner.node_tree = group
    value = goo.add("Value")
    value.outputs[0].default_value = 3.0
    goo.tree.links.new(value.outputs[0], inner.inputs["Density"])
    muted = goo.add("AddShader")
    goo.tree.links.new(inner.outputs[0], muted.inputs[0])
    muted.mute = True
    reroute = goo.tree.nodes.new("NodeReroute")
    goo.tree.links.new(muted.outputs[0], reroute.inputs[0])
    got, lines = medium(goo, reroute)
    assert lines == []
    assert [(lobe.sigma_s, lobe.g) for lobe in got.lobes] == [(pytest.approx((6, 6, 6)), 0.25)]
    # Unlinked, the group's own value counts.
    goo.tree.links.remove(inner.inputs["Density"].links[0])
    inner.inputs["Density"].default_value = 0.5
    assert goo.read()[0].medium.lobes[0].sigma_s == pytest.approx((1, 1, 1))


def test_rgb_node(goo):
    node = goo.add("VolumeAbsorption", Density=1.0)
    rgb = goo.add("RGB")
    rgb.outputs[0].default_value = (0.25, 0.5, 1.0, 1.0)
    goo.tree.links.new(rgb.outputs[0], node.inputs["Color"])
    got, lines = medium(goo, node)
    assert lines == [] and got.sigma_a == pytest.approx((0.75, 0.5, 0))


def test_texture_falls_back_and_is_named(goo):
    node = goo.add("VolumeScatter", Color=(1.0, 1.0, 1.0), Density=1.5)
    goo.tree.links.new(goo.add("TexNoise").outputs[0], node.inputs["Density"])
    got, lines = medium(goo, node)
    assert got.lobes[0].sigma_s == pytest.approx((1.5, 1.5, 1.5))
    assert lines == [
        'input "Density" is not a constant, its own value is used: ' + where("Volume Scatter")
    ]


def test_unknown_volume_is_named(goo):
    got, lines = medium(goo, goo.add("Emission"))
    assert got.lobes == ()
    assert lines == ["Emission is not understood in a volume and is ignored: " + where("Emission")]


@pytest.mark.skipif(bpy.app.version < (4, 3), reason="one phase function")
@pytest.mark.parametrize(
    ("phase", "g"), [("DRAINE", 0.5), ("FOURNIER_FORAND", 0), ("RAYLEIGH", 0), ("MIE", 0)]
)
def test_phase_function_is_named(goo, phase, g):
    """Only some phase functions have a socket for g."""
    node = goo.add("VolumeScatter", Density=1.0, Anisotropy=0.5)
    node.phase = phase
    got, lines = medium(goo, node)
    assert "replaced by Henyey-Greenstein" in lines[0] and lines[0].count(" g = 0") == (g == 0)
    assert got.lobes[0].g == g


def test_anisotropy_and_density_limits(goo):
    got, _ = medium(goo, goo.add("VolumeScatter", Density=-1.0))
    assert got.lobes == ()
    node = goo.add("VolumeScatter", Density=1.0, Anisotropy=1.0)
    goo.volume(node)
    assert goo.read()[0].medium.lobes[0].g == pytest.approx(0.999)


def test_volume_behind_an_opaque_surface_is_named(goo):
    goo.surface(goo.add("BsdfDiffuse"))
    goo.volume(goo.add("VolumeScatter"))
    assert "behind an opaque surface" in goo.read()[1][0]


def test_output_for_cycles_wins(goo):
    goo.glass()
    other = goo.add("OutputMaterial")
    other.target = "CYCLES"
    goo.link(goo.add("BsdfDiffuse", Color=(0.1, 0.1, 0.1)), other, "Surface")
    assert not goo.read()[0].is_dielectric


def test_scale_of_the_object_does_not_change_the_density(goo, scene):
    scene.objects["Thing"].scale = (2, 2, 2)
    got, _ = medium(goo, goo.add("VolumeScatter", Color=(1.0, 1.0, 1.0), Density=1.0))
    assert got.lobes[0].sigma_s == (1, 1, 1)


def test_materials_are_exported_once(goo, scene):
    twin = scene.objects["Thing"].copy()
    scene.collection.objects.link(twin)
    goo.glass()
    assert len(goo.export()[0].materials) == 1


# ---- Trees without end ---------------------------------------------------------------------------


def ladder(goo, node, steps):
    """Each step adds the one before to itself: 2^steps ways lead from the top to the node."""
    for _ in range(steps):
        step = goo.add("AddShader")
        goo.tree.links.new(node.outputs[0], step.inputs[0])
        goo.tree.links.new(node.outputs[0], step.inputs[1])
        node = step
    return node


def test_ladders_of_sums(goo):
    scatter = goo.add("VolumeScatter", Color=(1.0, 1.0, 1.0), Density=2.0**-60, Anisotropy=0.25)
    goo.volume(ladder(goo, scatter, 60))
    goo.glass()
    got, lines = goo.read()
    assert lines == [] and [lobe.g for lobe in got.medium.lobes] == [0.25]
    assert got.medium.lobes[0].sigma_s == pytest.approx((1, 1, 1))
    emission = goo.add("Emission", Color=(0.5, 1.0, 0.25), Strength=2.0**-60)
    goo.surface(ladder(goo, emission, 60))
    assert goo.read()[0].emission == pytest.approx((0.5, 1.0, 0.25))


def test_ladder_of_numbers(goo):
    node = goo.add("Value")
    node.outputs[0].default_value = 2.0**-60
    for _ in range(60):
        step = goo.add("Math")
        goo.tree.links.new(node.outputs[0], step.inputs[0])
        goo.tree.links.new(node.outputs[0], step.inputs[1])
        node = step
    scatter = goo.add("VolumeScatter", Color=(1.0, 1.0, 1.0))
    goo.link(node, scatter, "Density")
    got, lines = medium(goo, scatter)
    assert lines == [] and got.lobes[0].sigma_s == pytest.approx((1, 1, 1))


def test_power_beyond_all_numbers(goo):
    node = goo.add("Math")
    node.operation = "POWER"
    node.inputs[0].default_value = node.inputs[1].default_value = 1e6
    scatter = goo.add("VolumeScatter", Color=(1.0, 1.0, 1.0))
    goo.link(node, scatter, "Density")
    assert medium(goo, scatter)[0].lobes[0].sigma_s == (float("inf"),) * 3


def test_groups_of_groups_have_an_end(goo, monkeypatch):
    """Groups with two of the one before each; many of them would keep Blender itself busy."""
    monkeypatch.setattr(node_tree, "READ_MAX", 1000)
    inner = None
    for _ in range(12):
        group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
        if hasattr(group, "interface"):
            group.interface.new_socket("Out", in_out="OUTPUT", socket_type="NodeSocketShader")
        else:
            group.outputs.new("NodeSocketShader", "Out")
        both = group.nodes.new("ShaderNodeAddShader")
        for socket in both.inputs:
            node = group.nodes.new("ShaderNodeGroup" if inner else "ShaderNodeVolumeScatter")
            if inner:
                node.node_tree = inner
            group.links.new(node.outputs[0], socket)
        group.links.new(both.outputs[0], group.nodes.new("NodeGroupOutput").inputs[0])
        inner = group
    node = goo.tree.nodes.new("ShaderNodeGroup")
    node.node_tree = inner
    goo.volume(node)
    with pytest.raises(AmberlightError, match='material "Goo": its node groups hold too many'):
        goo.read()


def test_nodes_in_a_row_have_an_end(goo):
    node = goo.add("VolumeScatter")
    for _ in range(1000):
        step = goo.add("AddShader")
        goo.tree.links.new(node.outputs[0], step.inputs[0])
        node = step
    goo.volume(node)
    with pytest.raises(AmberlightError, match='material "Goo": its nodes are too many in a row'):
        goo.read()
