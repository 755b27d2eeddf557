# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes that nobody would make, each a function of its number: nodes, modifiers, lamps, cameras,
worlds and transforms as a user could combine them, ordinary values beside extreme ones. Runs in
Blender; what this version does not know is left out.
"""

import contextlib
import math
import random

import bpy

OLD = bpy.app.version < (4, 0)
EXTREMES = (0.0, 1.0, -1.0, 1e-7, 1e-3, 1e3, 1e6, -1e6)
WORDS = "Goo", "Glaß", "名前", "x" * 60, "a\nb", "%s {0}", '"', "", "Ärger.001"


class RandomScene:
    """Fills the current, empty scene."""

    def __init__(self, number):
        self.seed = number
        self.random = random.Random(number)
        self.scene = bpy.context.scene
        self.materials = []
        self.groups = []
        self.images = []
        self.things = []
        # How many scenes are wild, and how often a value in them is.
        self.wildness = self.random.choice((0.0, 0.0, 0.02, 0.1))

    # ---- Values ----------------------------------------------------------------------------------

    def chance(self, share):
        return self.random.random() < share

    def choice(self, items):
        return self.random.choice(list(items))

    def wild(self):
        return self.chance(self.wildness)

    def number(self, low=0.0, high=1.0):
        if self.wild():
            return self.choice((*EXTREMES, low, high, math.nan, math.inf))
        return self.random.uniform(low, high)

    def numbers(self, count, low=0.0, high=1.0):
        return [self.number(low, high) for _ in range(count)]

    def word(self):
        return self.choice(WORDS)

    def set(self, owner, **values):
        """Properties that this version has and takes."""
        for name, value in values.items():
            with contextlib.suppress(AttributeError, TypeError, ValueError):
                setattr(owner, name, value)

    def choose(self, owner, *names):
        """Enumerations to any of their values."""
        for name in names:
            item = owner.bl_rna.properties.get(name)
            if item is not None and item.enum_items:
                self.set(owner, **{name: self.choice(item.enum_items).identifier})

    # ---- Nodes -----------------------------------------------------------------------------------

    def sockets(self, node):
        for socket in node.inputs:
            if not hasattr(socket, "default_value") or self.chance(0.3):
                continue
            name, value = socket.name, socket.default_value
            with contextlib.suppress(TypeError, ValueError):
                if isinstance(value, float):
                    high = {"Density": 8.0, "IOR": 2.5, "Strength": 5.0}.get(name, 1.0)
                    low = {"IOR": 0.7, "Anisotropy": -1.0}.get(name, 0.0)
                    socket.default_value = self.number(low, high)
                elif isinstance(value, int):
                    socket.default_value = self.random.randint(0, 3)
                elif hasattr(value, "__len__") and not isinstance(value, str):
                    socket.default_value = (*self.numbers(3), 1.0)[: len(value)]
            if self.chance(0.02):
                self.drive(socket, "default_value")

    def drive(self, owner, path):
        with contextlib.suppress(TypeError, AttributeError, RuntimeError):
            curves = owner.driver_add(path)
            for curve in curves if isinstance(curves, list) else [curves]:
                expressions = ("frame / 7", "1 / 0", "nothing", "sin(frame)", "1e30 * frame", "")
                curve.driver.expression = self.choice(expressions)

    def node(self, tree, kind):
        """A node of this kind, or None where this Blender has none such."""
        try:
            node = tree.nodes.new(kind)
        except RuntimeError:
            return None
        self.sockets(node)
        for item in ("operation", "blend_type", "distribution", "phase", "projection", "mode"):
            if self.chance(0.3):
                self.choose(node, item)
        if self.chance(0.3):
            self.set(node, use_clamp=True)
        if self.wild():
            node.mute = True
        return node

    def link(self, tree, output, socket):
        if self.chance(0.1):
            route = tree.nodes.new("NodeReroute")
            tree.links.new(output, route.inputs[0])
            output = route.outputs[0]
        link = tree.links.new(output, socket)
        if self.wild():
            self.set(link, is_muted=True)

    COLORS = (
        "RGB Value Math MixRGB Mix TexNoise TexChecker TexImage CombineRGB CombineXYZ "
        "CombineColor Attribute Fresnel LayerWeight LightPath Gamma Blackbody VectorMath "
        "ValToRGB TexSky TexEnvironment BsdfDiffuse HueSaturation AmbientOcclusion Wavelength "
        "Wireframe"
    ).split()

    def color(self, tree, socket, depth=0):
        """Something behind an input of a number or a colour, now and then of the wrong type."""
        node = self.node(tree, f"ShaderNode{self.choice(self.COLORS)}")
        if node is None or not node.outputs:
            return
        if node.bl_idname in {"ShaderNodeRGB", "ShaderNodeValue"}:
            value = self.numbers(4) if node.outputs[0].type == "RGBA" else self.number()
            node.outputs[0].default_value = value
        if hasattr(node, "image"):
            node.image = self.image()
        for inner in node.inputs:
            if depth < 3 and self.chance(0.2):
                self.color(tree, inner, depth + 1)
        self.link(tree, self.choice(node.outputs), socket)

    def shader(self, tree, socket, kinds, depth=0):
        """A tree of shaders behind an input; may reuse what the tree has already."""
        made = [n for n in tree.nodes if n.outputs and n.outputs[0].type == "SHADER"]
        if made and self.chance(0.15):
            self.link(tree, self.choice(made).outputs[0], socket)
            return
        kind = self.choice(kinds)
        if depth < 4 and self.chance(0.3):
            kind = self.choice(("MixShader", "AddShader", "Group"))
        if kind == "Group":
            self.group(tree, socket, kinds, depth)
            return
        node = self.node(tree, f"ShaderNode{kind}")
        if node is None:
            return
        for inner in node.inputs:
            if inner.type == "SHADER":
                if self.chance(0.9):
                    self.shader(tree, inner, kinds, depth + 1)
            elif self.chance(0.1):
                self.color(tree, inner)
        self.link(tree, node.outputs[0], socket)

    def group(self, tree, socket, kinds, depth):
        if not self.groups or self.chance(0.7):
            group = bpy.data.node_groups.new(self.word(), "ShaderNodeTree")
            if OLD:
                group.inputs.new("NodeSocketColor", "Color")
                group.outputs.new("NodeSocketShader", "Shader")
            else:
                group.interface.new_socket("Color", in_out="INPUT", socket_type="NodeSocketColor")
                group.interface.new_socket(
                    "Shader", in_out="OUTPUT", socket_type="NodeSocketShader"
                )
            begin = group.nodes.new("NodeGroupInput")
            if self.chance(0.95):
                end = group.nodes.new("NodeGroupOutput")
                if self.chance(0.95):
                    self.shader(group, end.inputs[0], kinds, depth + 1)
            colors = [s for n in group.nodes for s in n.inputs if s.name in {"Color", "Density"}]
            if colors:
                self.link(group, begin.outputs[0], self.choice(colors))
            self.groups.append(group)
        node = tree.nodes.new("ShaderNodeGroup")
        group = self.choice(self.groups)
        if group != tree:
            with contextlib.suppress(RuntimeError, TypeError):
                node.node_tree = group
        if node.inputs:
            self.sockets(node)
            if self.chance(0.3):
                self.color(tree, node.inputs[0])
        if node.outputs:
            self.link(tree, node.outputs[0], socket)

    def ladder(self, tree, socket, kind):
        """Each step adds the one before to itself: terms double with every node."""
        node = self.node(tree, kind)
        for _ in range(self.choice((3, 12, 60))):
            step = tree.nodes.new("ShaderNodeAddShader")
            if node.outputs:
                tree.links.new(node.outputs[0], step.inputs[0])
                tree.links.new(node.outputs[0], step.inputs[1])
            node = step
        tree.links.new(node.outputs[0], socket)

    SURFACES = (
        "BsdfGlass BsdfGlass BsdfRefraction BsdfPrincipled BsdfPrincipled BsdfDiffuse Emission "
        "BsdfTransparent BsdfGlossy SubsurfaceScattering BsdfToon BsdfVelvet Holdout Background "
        "VolumeScatter BsdfHair ShaderToRGB"
    ).split()
    VOLUMES = (
        "VolumeScatter VolumeScatter VolumeAbsorption VolumePrincipled VolumeCoefficients "
        "Emission BsdfDiffuse"
    ).split()

    def material(self):
        if self.materials and self.chance(0.3):
            return self.choice(self.materials)
        material = bpy.data.materials.new(self.word())
        self.materials.append(material)
        self.set(material, use_nodes=not self.chance(0.05))
        with contextlib.suppress(AttributeError):
            material.amberlight.priority = self.random.randint(-2, 2)
        tree = material.node_tree
        if tree is None:
            return material
        tree.nodes.clear()
        if self.wild():
            return material
        output = tree.nodes.new("ShaderNodeOutputMaterial")
        if self.wild():
            self.choose(output, "target")
        if self.chance(0.7):
            self.translucent(tree, output)
        else:
            if self.chance(0.95):
                self.shader(tree, output.inputs["Surface"], self.SURFACES)
            if self.chance(0.5):
                self.shader(tree, output.inputs["Volume"], self.VOLUMES)
        if self.chance(0.03):
            self.ladder(tree, output.inputs["Volume"], "ShaderNodeVolumeScatter")
        if self.chance(0.03):
            self.ladder(tree, output.inputs["Surface"], "ShaderNodeBsdfDiffuse")
        if self.chance(0.05):
            self.color(tree, output.inputs["Displacement"])
        return material

    def translucent(self, tree, output):
        """What the engine is for, with values of its own."""
        glass = self.node(tree, self.choice(("ShaderNodeBsdfGlass", "ShaderNodeBsdfPrincipled")))
        for name in ("Transmission", "Transmission Weight"):
            if name in glass.inputs:
                glass.inputs[name].default_value = 1.0
        glass.inputs["IOR"].default_value = self.number(1.0, 2.0)
        self.link(tree, glass.outputs[0], output.inputs["Surface"])
        if self.chance(0.9):
            self.shader(tree, output.inputs["Volume"], self.VOLUMES[:4])

    def show_images(self):
        """Images on opaque surfaces, by a stream of its own: scenes are otherwise what they were
        without."""
        self.random = random.Random(f"images {self.seed}")
        for material in self.materials:
            if material.node_tree is None or self.chance(0.7):
                continue
            tree = material.node_tree
            tree.nodes.clear()
            output = tree.nodes.new("ShaderNodeOutputMaterial")
            kind = self.choice(("BsdfDiffuse", "BsdfDiffuse", "BsdfPrincipled", "Emission"))
            surface = self.node(tree, f"ShaderNode{kind}")
            self.link(tree, surface.outputs[0], output.inputs["Surface"])
            picture = tree.nodes.new("ShaderNodeTexImage")
            picture.image = self.image()
            self.choose(picture, "interpolation", "extension")
            if self.chance(0.1):
                self.choose(picture, "projection")
            self.link(tree, picture.outputs[0 if self.chance(0.9) else 1], surface.inputs[0])
            if self.chance(0.7):
                places = self.choice(("UVMap", "TexCoord"))
                source = self.node(tree, f"ShaderNode{places}")
                socket = source.outputs["UV"] if self.chance(0.8) else self.choice(source.outputs)
                if self.chance(0.6):
                    mapping = self.node(tree, "ShaderNodeMapping")
                    self.choose(mapping, "vector_type")
                    self.link(tree, socket, mapping.inputs["Vector"])
                    socket = mapping.outputs[0]
                self.link(tree, socket, picture.inputs["Vector"])
        for thing in self.things:
            layers = getattr(thing.data, "uv_layers", ())
            for layer in layers:
                if self.chance(0.2):
                    for place in layer.data:
                        place.uv = self.numbers(2, -3.0, 3.0)
                if self.wild():
                    layer.data.foreach_set("uv", [math.nan] * (2 * len(layer.data)))

    def image(self):
        if self.chance(0.1):
            return None
        if not self.images or self.chance(0.5):
            size = self.choice(((1, 1), (2, 1), (16, 8), (7, 5)))
            image = bpy.data.images.new(
                self.word(), *size, float_buffer=self.chance(0.7), alpha=self.chance(0.5)
            )
            values = self.numbers(4 * size[0] * size[1], 0.0, 2.0)
            if self.chance(0.3):
                values[self.random.randrange(len(values))] = 1e5
            image.pixels.foreach_set(values)
            if self.chance(0.1):
                image.source, image.filepath = "FILE", "//nowhere.exr"
            if self.chance(0.1):
                self.choose(image, "source", "alpha_mode")
            self.images.append(image)
        return self.choice(self.images)

    # ---- Objects ---------------------------------------------------------------------------------

    def place(self, thing):
        """Somewhere near the middle, now and then by a transform that has no inverse."""
        thing.location = self.numbers(3, -2.0, 2.0)
        if self.chance(0.6):
            thing.rotation_euler = self.numbers(3, -4.0, 4.0)
        if self.chance(0.4):
            thing.scale = self.numbers(3, 0.2, 1.5)
        if self.chance(0.05):
            thing.scale[self.random.randrange(3)] *= self.choice((0.0, -1.0, 1e-6, 1e4))
        if self.chance(0.04):
            thing.location = [c * self.choice((1e3, 1e5, 1e30)) for c in thing.location]
        if self.chance(0.03):
            thing.matrix_world = [self.numbers(4, -1.0, 1.0) for _ in range(3)] + [[0, 0, 0, 1]]
        if self.chance(0.1) and self.things:
            thing.parent = self.choice(self.things)
        if self.chance(0.1):
            path = self.choice(("location", "scale", "rotation_euler", "hide_render"))
            with contextlib.suppress(RuntimeError, TypeError):
                thing.keyframe_insert(path, frame=1)
                setattr(thing, path, self.numbers(3, -1, 1) if path != "hide_render" else True)
                thing.keyframe_insert(path, frame=5)
        if self.chance(0.04):
            self.drive(thing, self.choice(("location", "scale", "hide_render")))
        if self.chance(0.05):
            thing.hide_render = True
        if self.chance(0.05):
            self.choose(thing, "display_type")
            # An instance of every child at every vertex, and of their children at theirs.
            if len(getattr(thing.data, "vertices", ())) < 10:
                self.choose(thing, "instance_type")
        if self.chance(0.03):
            self.set(thing, is_holdout=True, is_shadow_catcher=True, visible_camera=False)
        self.things.append(thing)

    PRIMITIVES = {
        "cube": {},
        "plane": {},
        "circle": {"vertices": 7, "fill_type": "NGON"},
        "cone": {"vertices": 9},
        "cylinder": {"vertices": 8},
        "torus": {"major_segments": 12, "minor_segments": 6},
        "uv_sphere": {"segments": 12, "ring_count": 6},
        "ico_sphere": {"subdivisions": 2},
        "grid": {"x_subdivisions": 4, "y_subdivisions": 3},
        "monkey": {},
    }

    def mesh(self):
        kind = self.choice(self.PRIMITIVES)
        getattr(bpy.ops.mesh, f"primitive_{kind}_add")(**self.PRIMITIVES[kind])
        thing = bpy.context.object
        mesh = thing.data
        if self.chance(0.6):
            mesh.polygons.foreach_set("use_smooth", [not self.wild() for _ in mesh.polygons])
        if self.chance(0.2):
            self.set(mesh, use_auto_smooth=True)
        if self.chance(0.1):
            mesh.flip_normals()
        if self.chance(0.15):
            self.damage(mesh)
        if self.chance(0.05):
            with contextlib.suppress(RuntimeError):
                mesh.normals_split_custom_set([self.numbers(3, -1, 1) for _ in mesh.loops])
        return thing

    def damage(self, mesh):
        """Vertices that coincide, lie far away or nowhere; or no faces at all."""
        kind = self.random.randrange(5)
        if kind == 0:
            mesh.clear_geometry()
        elif kind == 1:
            mesh.vertices[0].co = self.numbers(3, -100.0, 100.0)
        elif kind == 2:
            for vertex in mesh.vertices[: len(mesh.vertices) // 2]:
                vertex.co = mesh.vertices[0].co
        elif kind == 3:
            for vertex in mesh.vertices:
                vertex.co.z = 0.0
        else:
            mesh.vertices[-1].co.x = self.choice((math.nan, math.inf, 1e30, 1e19))

    def text(self):
        bpy.ops.object.text_add()
        thing = bpy.context.object
        self.set(thing.data, body=self.choice(("Ab", "", "W\nx")), extrude=self.number(0.0, 0.3))
        self.set(thing.data, bevel_depth=self.choice((0.0, 0.02)), resolution_u=2)
        return thing

    def curve(self):
        kind = self.choice(("bezier_curve", "bezier_circle", "nurbs_circle", "nurbs_path"))
        getattr(bpy.ops.curve, f"primitive_{kind}_add")()
        curve = bpy.context.object.data
        self.set(curve, resolution_u=3, bevel_resolution=1, dimensions=self.choice(("2D", "3D")))
        self.set(curve, extrude=self.choice((0.0, 0.2)), bevel_depth=self.choice((0.0, 0.1)))
        self.set(curve, use_fill_caps=self.chance(0.5), fill_mode="FULL")
        return bpy.context.object

    def surface(self):
        kind = self.choice(("sphere", "torus", "surface", "cylinder"))
        getattr(bpy.ops.surface, f"primitive_nurbs_surface_{kind}_add")()
        self.set(bpy.context.object.data, resolution_u=2, resolution_v=2)
        return bpy.context.object

    def metaball(self):
        kinds = ("BALL", "CAPSULE", "PLANE", "ELLIPSOID", "CUBE")
        bpy.ops.object.metaball_add(type=self.choice(kinds))
        data = bpy.context.object.data
        data.resolution = data.render_resolution = 0.5
        if self.chance(0.3):
            data.elements[0].use_negative = True
        return bpy.context.object

    def other(self):
        """What has no surface."""
        kind = self.choice(("EMPTY", "ARMATURE", "LATTICE", "VOLUME", "SPEAKER", "CURVES"))
        with contextlib.suppress(RuntimeError, AttributeError):
            {
                "EMPTY": bpy.ops.object.empty_add,
                "ARMATURE": bpy.ops.object.armature_add,
                "VOLUME": bpy.ops.object.volume_add,
                "SPEAKER": bpy.ops.object.speaker_add,
                "CURVES": bpy.ops.object.curves_empty_hair_add,
            }.get(kind, lambda: bpy.ops.object.add(type="LATTICE"))()
            return bpy.context.object
        return None

    def modifier(self, thing):
        kinds = (
            "SUBSURF BEVEL BOOLEAN ARRAY MIRROR SOLIDIFY REMESH DECIMATE TRIANGULATE DISPLACE "
            "SIMPLE_DEFORM CAST WIREFRAME SCREW SKIN MASK BUILD WELD SMOOTH EDGE_SPLIT "
            "WEIGHTED_NORMAL EXPLODE WAVE NODES"
        )
        kind = self.choice(kinds.split())
        size = len(getattr(thing.data, "polygons", ""))
        if kind == "SKIN" and size > 50:
            return  # Blender takes many seconds
        try:
            modifier = thing.modifiers.new(self.word(), kind)
        except (RuntimeError, TypeError):
            return
        if modifier is None:
            return
        count = 2 if size < 200 else 1
        self.choose(modifier, "mode", "operation", "solver", "decimate_type", "deform_method")
        self.choose(modifier, "offset_type", "limit_method", "subdivision_type")
        self.set(modifier, levels=count, render_levels=count, segments=count, count=count + 1)
        self.set(modifier, steps=6, render_steps=6, ratio=self.number(), octree_depth=3)
        self.set(modifier, voxel_size=self.choice((0.15, 0.4, 10.0)), strength=self.number(-1, 1))
        self.set(modifier, thickness=self.choice((0.0, 0.1, -0.3, 2.0)), factor=self.number(-2, 2))
        self.set(modifier, width=self.number(0.0, 0.3), use_bisect_axis=[self.chance(0.5)] * 3)
        self.set(modifier, show_render=not self.chance(0.1))
        others = [t for t in self.things if t.type == "MESH" and t != thing]
        if kind == "BOOLEAN" and others:
            modifier.object = self.choice(others)
        if kind == "MIRROR" and others and self.chance(0.3):
            modifier.mirror_object = self.choice(others)
        if kind == "NODES":
            self.set(modifier, node_group=self.instancer())

    def instancer(self):
        """Geometry nodes that put one object onto the points of another."""
        group = bpy.data.node_groups.new("Points", "GeometryNodeTree")
        if OLD:
            group.inputs.new("NodeSocketGeometry", "Geometry")
            group.outputs.new("NodeSocketGeometry", "Geometry")
        else:
            for side in ("INPUT", "OUTPUT"):
                group.interface.new_socket(
                    "Geometry", in_out=side, socket_type="NodeSocketGeometry"
                )
        begin, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
        points = group.nodes.new("GeometryNodeInstanceOnPoints")
        shape = group.nodes.new(
            f"GeometryNodeMesh{self.choice(('Cube', 'IcoSphere', 'Line', 'Circle'))}"
        )
        points.inputs["Scale"].default_value = self.numbers(3, 0.05, 0.3)
        group.links.new(begin.outputs[0], points.inputs["Points"])
        group.links.new(shape.outputs[0], points.inputs["Instance"])
        group.links.new(points.outputs[0], end.inputs[0])
        return group

    def add_object(self):
        makers = [self.mesh] * 6
        makers += [self.text, self.curve, self.surface, self.metaball, self.other]
        thing = self.choice(makers)()
        if thing is None:
            return
        if not self.wild():
            self.set(thing, name=self.word())
        self.place(thing)
        data = thing.data
        if hasattr(data, "materials"):
            for _ in range(self.choice((0, 1, 1, 1, 2, 3))):
                data.materials.append(None if self.chance(0.05) else self.material())
            faces = getattr(data, "polygons", ())
            if len(data.materials) > 1 or self.chance(0.05):
                for face in faces:
                    face.material_index = self.random.randrange(4)
        for _ in range(self.choice((0, 0, 1, 1, 2))):
            if len(thing.modifiers) < 2 and thing.type in {"MESH", "CURVE", "FONT", "SURFACE"}:
                self.modifier(thing)
        if thing.type == "MESH" and self.chance(0.03):
            with contextlib.suppress(RuntimeError):
                thing.modifiers.new("", "PARTICLE_SYSTEM")
                settings = thing.particle_systems[0].settings
                self.set(settings, type=self.choice(("HAIR", "EMITTER")), count=7, frame_end=2)
                self.set(settings, render_type=self.choice(("OBJECT", "PATH", "HALO")))
                self.set(settings, instance_object=self.choice(self.things))

    def instance_collection(self):
        collection = bpy.data.collections.new(self.word())
        for thing in self.random.sample(self.things, min(2, len(self.things))):
            collection.objects.link(thing)
        for _ in range(self.choice((1, 2, 5))):
            empty = bpy.data.objects.new(self.word(), None)
            self.scene.collection.objects.link(empty)
            empty.instance_type, empty.instance_collection = "COLLECTION", collection
            self.place(empty)

    # ---- Lamps, camera, world --------------------------------------------------------------------

    def add_light(self):
        light = bpy.data.lights.new(self.word(), self.choice(("POINT", "SUN", "SPOT", "AREA")))
        light.energy = self.number(0.0, 5.0 if light.type == "SUN" else 500.0)
        light.color = self.numbers(3)
        self.set(light, shadow_soft_size=self.choice((0.0, 0.1, self.number(0.0, 2.0))))
        self.set(light, angle=self.choice((0.0, 0.01, self.number(0.0, 3.1))))
        self.set(light, spot_size=self.number(0.02, 3.0), spot_blend=self.number())
        self.choose(light, "shape")
        self.set(light, size=self.number(0.0, 2.0), size_y=self.number(0.0, 2.0))
        self.set(light, use_temperature=self.chance(0.2), exposure=self.number(-1.0, 1.0))
        if self.chance(0.2):
            light.use_nodes = True
            if light.node_tree:
                output = light.node_tree.nodes.get("Light Output")
                if output:
                    self.shader(light.node_tree, output.inputs[0], ("Emission", "Background"))
        thing = bpy.data.objects.new(self.word(), light)
        self.scene.collection.objects.link(thing)
        self.place(thing)
        if self.chance(0.7):
            thing.location = self.numbers(3, -1.0, 1.0)
            thing.location.z = self.number(2.0, 6.0)
        if self.things and self.chance(0.05):
            thing.location = self.choice(self.things).location

    def add_camera(self):
        camera = bpy.data.cameras.new(self.word())
        camera.type = "ORTHO" if self.chance(0.2) else "PERSP"
        if self.wild():
            camera.type = "PANO"
        self.choose(camera, "sensor_fit")
        camera.lens = self.number(10.0, 80.0)
        camera.ortho_scale = self.number(1.0, 8.0)
        if self.chance(0.2):
            camera.shift_x, camera.shift_y = self.numbers(2, -10.0, 10.0)
        if self.chance(0.2):
            camera.clip_start, camera.clip_end = self.number(0.0, 5.0), self.number(5.0, 20.0)
        if self.chance(0.2):
            camera.dof.use_dof = True
            camera.dof.focus_distance = self.number(0.0, 8.0)
            camera.dof.aperture_fstop = self.choice((0.0, 0.01, 1.4, 1e6))
            if self.things and self.chance(0.5):
                camera.dof.focus_object = self.choice(self.things)
        thing = bpy.data.objects.new(self.word(), camera)
        self.scene.collection.objects.link(thing)
        thing.location = (0.0, -6.0, 0.0)
        thing.rotation_euler = (math.pi / 2, 0.0, 0.0)
        if self.chance(0.2):
            self.place(thing)
        self.scene.camera = thing
        if self.wild():
            self.scene.camera = self.choice([None, *self.things])

    def add_world(self):
        world = bpy.data.worlds.new(self.word())
        self.scene.world = world
        self.set(world, use_nodes=self.chance(0.9))
        self.set(world, color=self.numbers(3))
        # Cycles bakes what we do not understand, which is to take little of a scene's time.
        self.set(world.amberlight, width=64)
        tree = world.node_tree
        if tree is None:
            return
        tree.nodes.clear()
        if self.wild():
            return
        output = tree.nodes.new("ShaderNodeOutputWorld")
        if self.chance(0.4):
            background = self.node(tree, "ShaderNodeBackground")
            background.inputs["Strength"].default_value = self.number(0.0, 2.0)
            texture = self.node(tree, "ShaderNodeTexEnvironment")
            texture.image = self.image()
            if self.chance(0.4):
                mapping = self.node(tree, "ShaderNodeMapping")
                self.link(tree, mapping.outputs[0], texture.inputs[0])
            self.link(tree, texture.outputs[0], background.inputs["Color"])
            self.link(tree, background.outputs[0], output.inputs["Surface"])
        else:
            kinds = ("Background", "Emission", "BsdfDiffuse")
            self.shader(tree, output.inputs["Surface"], kinds)
            if self.chance(0.1):
                self.shader(tree, output.inputs["Volume"], self.VOLUMES)

    # ---- Settings --------------------------------------------------------------------------------

    def settings(self):
        scene, render = self.scene, self.scene.render
        render.engine = "AMBERLIGHT"
        render.threads_mode, render.threads = "FIXED", 1
        render.resolution_x, render.resolution_y = self.choice((4, 9, 16)), self.choice((5, 12, 16))
        if self.wild():
            render.resolution_x = render.resolution_y = self.choice((1, 3, 4))
        render.resolution_percentage = 60 if self.chance(0.1) else 100
        render.film_transparent = self.chance(0.3)
        render.use_motion_blur = self.chance(0.1)
        render.use_multiview = self.chance(0.03)
        if self.chance(0.2):
            render.pixel_aspect_x = self.number(1.0, 3.0)
        if self.chance(0.2):
            render.use_border, render.use_crop_to_border = True, self.chance(0.5)
            low, high = sorted((self.random.random(), self.random.random()))
            render.border_min_x = render.border_min_y = low
            render.border_max_x = render.border_max_y = high
        own = scene.amberlight
        own.samples = self.choice((1, 1, 2))
        own.light_samples = self.choice((1, 7, 200, 1000))
        own.seed = self.random.randrange(1000)
        if self.chance(0.6):
            self.choose(own, "estimator", "scatter_estimator", "effects")
            own.light_bounces = self.random.randint(0, 3)
            own.camera_bounces = self.random.randint(0, 3)
            own.scatter_order_max = self.random.randint(0, 4)
            own.kernel_size = self.number(0.5, 30.0)
            for item in own.bl_rna.properties:
                if item.identifier.startswith("use_") or item.identifier == "adjoint_normals":
                    setattr(own, item.identifier, self.chance(0.7))
        if self.chance(0.03):
            own.accuracy = self.choice((0.2, 1.0))
        own.memory_limit = self.choice((0, 64, 64, 64, 1))
        if self.chance(0.1):
            scene.view_layers.new(self.word() or "Layer")
        layer = scene.view_layers[0]
        layer.use_pass_z = self.chance(0.5)
        if self.materials and self.chance(0.05):
            layer.material_override = self.choice(self.materials)
        scene.frame_set(self.random.randint(1, 6))

    def fill(self):
        for _ in range(self.choice((0, 1, 1, 2, 2, 3, 4))):
            self.add_object()
        if self.chance(0.15):
            self.instance_collection()
        for _ in range(self.choice((0, 1, 1, 1, 2, 3))):
            self.add_light()
        if self.chance(0.7):
            self.add_world()
        if not self.wild():
            self.add_camera()
        self.settings()
        self.show_images()
