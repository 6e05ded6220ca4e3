# SPDX-License-Identifier: MIT
"""Files that a model names beside it: buffers and images of a .gltf, the material library of an .obj and the images
of that. None outside the model's folder is named, neither by its path nor by a link."""
import json
import os
import re
import stat
from typing import List, Tuple
from urllib.parse import unquote

from .errors import RelightError

_MAX_NAME = 200  # bytes, as the daemon has it
_MAPS = re.compile(rb"[ \t]*(?:map_Kd|map_Ke|map_Pr|norm|map_Kn|map_Bump|bump)[ \t]+(.+)")
_LIBRARY = re.compile(rb"[ \t]*mtllib[ \t]+(.+)")


def _is_inside(folder: str, name: str) -> bool:
    if not name or name.startswith("/") or ".." in name.split("/"):
        return False
    base = os.path.realpath(folder)
    return os.path.commonpath([base, os.path.realpath(os.path.join(folder, name))]) == base


def _is_plain(name: str) -> bool:
    odd = any(ord(c) < 32 or c in "\x7f\\" for c in name) or name.startswith(".") or re.search(r"/[./]", name)
    return not odd and len(name.encode("utf-8", "replace")) <= _MAX_NAME


def _can_send(folder: str, name: str) -> bool:
    if not _is_inside(folder, name) or not _is_plain(name):
        return False
    try:
        state = os.stat(os.path.join(folder, name))
    except OSError:
        return False
    return stat.S_ISREG(state.st_mode) and state.st_size > 0


def _gltf(path: str, folder: str) -> List[str]:
    try:
        with open(path, "rb") as file:
            text = json.loads(file.read())
    except ValueError as fault:
        raise RelightError("ARGUMENT", "%s: is not JSON: %s" % (path, fault)) from fault
    out: List[str] = []
    for kind in ("buffers", "images"):
        found = text.get(kind) if isinstance(text, dict) else None
        for item in found if isinstance(found, list) else []:
            uri = item.get("uri") if isinstance(item, dict) else None
            if not isinstance(uri, str) or uri[:5].lower() == "data:":
                continue
            name = unquote(uri)
            while name.startswith("./"):
                name = name[2:]
            if _can_send(folder, name):
                out.append(name)
            elif kind == "buffers":  # the model cannot be read without it
                raise RelightError("ARGUMENT", "%s: buffer '%s' is not a file in the model's folder" % (path, name),
                                   "move the buffer beside the model")
    return out


def _behind(pattern: "re.Pattern[bytes]", path: str) -> List[str]:
    """What stands behind the word that the pattern names, line by line."""
    out = []
    with open(path, "rb") as file:
        for line in file:
            found = pattern.match(line)
            if found:
                out.append(found.group(1).decode("utf-8", "replace").strip())
    return out


def _image(folder: str, text: str) -> List[str]:
    """A line's image: the first of its words from which on the line names a file; options stand before it."""
    text = text.replace("\\", "/")
    for word in re.finditer(r"[^ \t]+", text):
        name = text[word.start():]
        if name.startswith("/") or ":" in name:
            name = name.rsplit("/", 1)[-1] if "/" in name else ""
        if _can_send(folder, name):
            return [name]
    return []


def _obj(path: str, folder: str) -> List[str]:
    out: List[str] = []
    lines = _behind(_LIBRARY, path)
    # a line is one name that may hold blanks, or several names between blanks
    for library in (name for line in lines for name in ([line] if _can_send(folder, line) else line.split())):
        if not _can_send(folder, library):
            continue
        out.append(library)
        for text in _behind(_MAPS, os.path.join(folder, library)):
            out += _image(folder, text)
    return out


def named_files(path: str) -> List[Tuple[str, str]]:
    """Names and paths of the files that the model at `path` names. RelightError: a .gltf that is not JSON, or whose
    buffers are not there; what else is missing the daemon warns of."""
    folder = os.path.dirname(path) or "."
    ending = os.path.splitext(path)[1].lower()
    found = _gltf(path, folder) if ending == ".gltf" else _obj(path, folder) if ending == ".obj" else []
    return [(name, os.path.join(folder, name)) for name in dict.fromkeys(found)]
