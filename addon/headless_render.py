# SPDX-License-Identifier: GPL-3.0-or-later
"""Render the open file for `./amberlight render`, which runs this inside Blender.

    blender -b FILE -E AMBERLIGHT --python headless_render.py -- DIR [SETTING=VALUE ...]

Writes DIR/<file>.exr (every pass, by the C library), .png (Blender's colour management) and
.json (the report). Ends Blender with exit code 1 and one sentence when anything fails.
"""

from __future__ import annotations

import difflib
import sys
from pathlib import Path

import bpy

TRUE = {"1", "true", "on", "yes"}
FALSE = {"0", "false", "off", "no"}


class SettingError(ValueError):
    """A SETTING=VALUE of the command line that cannot be applied."""


def setting_names(owner: bpy.types.bpy_struct) -> list[str]:
    """Names of the properties of `owner` that can be set, without Blender's own `name`."""
    return sorted(
        p.identifier
        for p in owner.bl_rna.properties
        if not p.is_readonly and p.identifier not in {"rna_type", "name"}
    )


def owner_and_name(scene: bpy.types.Scene, path: str) -> tuple[bpy.types.bpy_struct, str]:
    """Struct and property that a setting means: `samples` or `scene.render.resolution_x`."""
    *owners, name = path.split(".")
    if not owners:
        return scene.amberlight, name
    if owners[0] != "scene":
        raise SettingError(f"{path}: a path begins with 'scene.'")
    owner: bpy.types.bpy_struct = scene
    for part in owners[1:]:
        prop = owner.bl_rna.properties.get(part)
        if prop is None or prop.type != "POINTER" or getattr(owner, part) is None:
            raise SettingError(f"{path}: no '{part}' in {owner.bl_rna.identifier}")
        owner = getattr(owner, part)
    return owner, name


def parse_bool(text: str) -> bool:
    if text.lower() in TRUE:
        return True
    if text.lower() in FALSE:
        return False
    raise ValueError("neither true nor false")


def parse_int(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise ValueError("not a whole number") from None


def parse_float(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError("not a number") from None


def parse_enum(prop: bpy.types.EnumProperty, text: str) -> str:
    """The item's own spelling; what is not listed may still exist: Blender judges when it is set,
    because it fills some enums only then."""
    for item in prop.enum_items:
        if item.identifier.lower() == text.lower():
            return item.identifier
    return text


def parse_value(prop: bpy.types.Property, text: str) -> object:
    """`text` as a value of the type of `prop`; arrays are separated by commas."""
    parsers = {
        "BOOLEAN": parse_bool,
        "INT": parse_int,
        "FLOAT": parse_float,
        "STRING": str,
        "ENUM": lambda part: parse_enum(prop, part),
    }
    parse = parsers.get(prop.type)
    if parse is None:
        raise ValueError(f"a {prop.type.lower()} cannot be set from the command line")
    if getattr(prop, "is_array", False):
        parts = [parse(part) for part in text.split(",")]
        if len(parts) != prop.array_length:
            raise ValueError(f"not {prop.array_length} values separated by commas")
        return parts
    return parse(text)


def check_range(prop: bpy.types.Property, value: object) -> None:
    """Blender clamps in silence; here a number out of range is an error."""
    if prop.type not in {"INT", "FLOAT"} or isinstance(value, list):
        return
    if not prop.hard_min <= value <= prop.hard_max:
        raise ValueError(f"not between {prop.hard_min:.10g} and {prop.hard_max:.10g}")


def suggestions(owner: bpy.types.bpy_struct, name: str) -> str:
    """Our own settings all; of Blender's hundreds, those that look alike."""
    names = setting_names(owner)
    if not name or len(names) < 40:
        return "there are " + ", ".join(names)
    alike = difflib.get_close_matches(name, names, n=5)
    return "do you mean " + " or ".join(alike) + "?" if alike else "nothing is named like it"


def apply_setting(scene: bpy.types.Scene, setting: str) -> None:
    path, _, text = setting.partition("=")
    owner, name = owner_and_name(scene, path)
    if name not in setting_names(owner):
        raise SettingError(f"unknown setting {path}: {suggestions(owner, name)}")
    prop = owner.bl_rna.properties[name]
    try:
        value = parse_value(prop, text)
        check_range(prop, value)
        setattr(owner, name, value)
    except (TypeError, ValueError) as error:
        # Blender's own texts begin with the name of a C function.
        raise SettingError(f"{setting}: {str(error).rsplit(': ', 1)[-1]}") from error


def write_png(scene: bpy.types.Scene, path: Path) -> None:
    """Point Blender's output at a PNG with the scene's own view transform."""
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):  # Blender 5: the kinds of file depend on it
        settings.media_type = "IMAGE"
    settings.file_format = "PNG"
    settings.color_mode = "RGBA" if scene.render.film_transparent else "RGB"
    scene.render.use_file_extension = True
    scene.render.filepath = str(path)


def render(scene: bpy.types.Scene, folder: Path, name: str) -> list[Path]:
    """Render the current frame; return the files that it made."""
    files = [folder / f"{name}{suffix}" for suffix in (".exr", ".png", ".json")]
    for file in files:  # a failed render must not leave the pictures of an earlier one
        file.unlink(missing_ok=True)
    exr, png, report = (file.resolve() for file in files)
    scene.amberlight.exr_path = str(exr)
    scene.amberlight.report_path = str(report)
    write_png(scene, png)
    if "FINISHED" not in bpy.ops.render.render(write_still=True):
        raise RuntimeError("cancelled")
    missing = [file.name for file in files if not file.is_file()]
    if len(missing) == len(files):  # Blender calls a render finished that it stopped at Ctrl-C
        raise RuntimeError("cancelled")
    if missing:
        raise RuntimeError("not written: " + ", ".join(missing))
    return files


def main(arguments: list[str]) -> None:
    folder, *settings = arguments
    scene = bpy.context.scene
    if not hasattr(scene, "amberlight"):
        raise RuntimeError("the add-on 'amberlight' is not enabled")
    scene.render.engine = "AMBERLIGHT"
    for setting in settings:
        apply_setting(scene, setting)
    directory = Path(folder)
    directory.mkdir(parents=True, exist_ok=True)
    for file in render(scene, directory, Path(bpy.data.filepath).stem):
        print(f"wrote {file}", flush=True)


if __name__ == "__main__":
    try:
        main(sys.argv[sys.argv.index("--") + 1 :])
    except (OSError, RuntimeError, SettingError) as error:
        message = str(error).removeprefix("Error: ").rstrip()
        print(f"amberlight: {message}", file=sys.stderr, flush=True)
        sys.exit(1)
