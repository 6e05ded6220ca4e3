#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Models of deploy/gallery as .glb files with their own media (KHR_materials_volume_scatter).

  gallery_models.py candle OUT.glb     a candle: wax, a wick inside it, a holder
  gallery_models.py plastics OUT.glb   three plastics: a block, a ring around it, a ball on top

Lengths are in metres, +y is up.
"""
import json
import math
import struct
import sys


def lathe(profile, n, closed=False):
    """A surface of revolution about y of (radius, height) points, from the top's axis to the
    bottom's, or around a closed profile."""
    rows = profile + profile[:1] if closed else profile
    points, triangles = [], []
    for radius, y in profile:
        for k in range(n):
            a = 2 * math.pi * k / n
            points.append((radius * math.cos(a), y, -radius * math.sin(a)))
    for r in range(len(rows) - 1):
        below = (r + 1) % len(profile)
        for k in range(n):
            a, b = r * n + k, r * n + (k + 1) % n
            c, d = below * n + k, below * n + (k + 1) % n
            if profile[r][0] > 0:
                triangles.append((a, c, b))
            if profile[below][0] > 0:
                triangles.append((b, c, d))
    return points, triangles


def refine(profile, step):
    out = []
    for (r0, y0), (r1, y1) in zip(profile, profile[1:]):
        n = max(1, math.ceil(math.hypot(r1 - r0, y1 - y0) / step))
        out += [(r0 + (r1 - r0) * k / n, y0 + (y1 - y0) * k / n) for k in range(n)]
    return out + profile[-1:]


def rounded(profile, radius, n=5):
    """Cuts the inner corners of an open profile by arcs."""
    out = [profile[0]]
    for before, at, after in zip(profile, profile[1:], profile[2:]):
        def towards(to):
            length = math.hypot(to[0] - at[0], to[1] - at[1])
            share = min(radius / length, 0.45)
            return (at[0] + share * (to[0] - at[0]), at[1] + share * (to[1] - at[1]))
        a, b = towards(before), towards(after)
        for k in range(n + 1):
            t = k / n
            out.append(tuple((1 - t) ** 2 * p + 2 * t * (1 - t) * q + t ** 2 * r
                             for p, q, r in zip(a, at, b)))
    return out + profile[-1:]


def ball(center, radius, n=64):
    profile = [(radius * math.sin(math.pi * k / n), radius * math.cos(math.pi * k / n))
               for k in range(n + 1)]
    profile[0], profile[-1] = (0, radius), (0, -radius)
    points, triangles = lathe(profile, 2 * n)
    return [(x + center[0], y + center[1], z + center[2]) for x, y, z in points], triangles


def torus(ring, tube, y, n=48):
    profile = [(ring + tube * math.sin(2 * math.pi * k / n), y + tube * math.cos(2 * math.pi * k / n))
               for k in range(n)]
    return lathe(profile, 3 * n, closed=True)


def medium(name, color, mean_free_path, roughness, anisotropy=0.0, ior=1.45):
    """A dense medium: sigma_t = 1/mean free path (metres), so e^-1 is left after it."""
    return {
        "name": name,
        "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 1], "metallicFactor": 0,
                                 "roughnessFactor": roughness},
        "extensions": {
            "KHR_materials_ior": {"ior": ior},
            "KHR_materials_transmission": {"transmissionFactor": 1},
            "KHR_materials_volume": {"thicknessFactor": 1, "attenuationDistance": mean_free_path,
                                     "attenuationColor": [math.exp(-1)] * 3},
            "KHR_materials_volume_scatter": {"multiscatterColor": color,
                                             "scatterAnisotropy": anisotropy}}}


def opaque(name, color, roughness):
    return {"name": name, "pbrMetallicRoughness": {"baseColorFactor": color + [1], "metallicFactor": 0,
                                                   "roughnessFactor": roughness}}


def candle():
    """80 mm of wax with a molten hollow, a wick that reaches into it, a dish with a rim."""
    wax = rounded([(0, 0.082), (0.0105, 0.082), (0.0145, 0.088), (0.0185, 0.088), (0.0185, 0.006),
                   (0, 0.006)], 0.003)
    wick = rounded([(0, 0.096), (0.0011, 0.096), (0.0011, 0.05), (0, 0.05)], 0.0004, 3)
    dish = rounded([(0, 0.0055), (0.030, 0.0055), (0.041, 0.013), (0.044, 0.0125), (0.033, 0), (0, 0)],
                   0.002)
    return [("wax", lathe(refine(wax, 0.0009), 96), medium("wax", [0.93, 0.85, 0.68], 0.0016, 0.35)),
            ("wick", lathe(refine(wick, 0.0006), 20), opaque("wick", [0.03, 0.025, 0.02], 0.9)),
            ("holder", lathe(refine(dish, 0.0012), 96), opaque("holder", [0.12, 0.16, 0.3], 0.3))]


def plastics():
    """A block of white, a ring of red and a ball of green plastic."""
    block = rounded([(0, 0.030), (0.021, 0.030), (0.021, 0), (0, 0)], 0.003)
    return [("block", lathe(refine(block, 0.0008), 96), medium("white", [0.9, 0.9, 0.88], 0.0008, 0.2)),
            ("ring", torus(0.0285, 0.0070, 0.0071), medium("red", [0.75, 0.08, 0.05], 0.0012, 0.25)),
            ("ball", ball((0, 0.0431, 0), 0.013), medium("green", [0.2, 0.7, 0.3], 0.003, 0.12))]


def write(path, parts):
    binary, views, accessors, meshes, nodes, materials = b"", [], [], [], [], []

    def section(data, target):
        nonlocal binary
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data), "target": target})
        binary += data + b"\0" * (-len(data) % 4)
        return len(views) - 1

    for name, (points, triangles), material in parts:
        flat = [x for p in points for x in p]
        at = section(struct.pack(f"<{len(flat)}f", *flat), 34962)
        accessors.append({"bufferView": at, "componentType": 5126, "count": len(points), "type": "VEC3",
                          "min": [min(p[i] for p in points) for i in range(3)],
                          "max": [max(p[i] for p in points) for i in range(3)]})
        flat = [i for t in triangles for i in t]
        at = section(struct.pack(f"<{len(flat)}I", *flat), 34963)
        accessors.append({"bufferView": at, "componentType": 5125, "count": len(flat), "type": "SCALAR"})
        meshes.append({"name": name, "primitives": [{
            "attributes": {"POSITION": len(accessors) - 2}, "indices": len(accessors) - 1,
            "material": len(materials)}]})
        nodes.append({"name": name, "mesh": len(meshes) - 1})
        materials.append(material)
    used = sorted({e for m in materials for e in m.get("extensions", {})})
    text = json.dumps({"asset": {"version": "2.0"}, "extensionsUsed": used, "scene": 0,
                       "scenes": [{"nodes": list(range(len(nodes)))}], "nodes": nodes, "meshes": meshes,
                       "materials": materials, "accessors": accessors, "bufferViews": views,
                       "buffers": [{"byteLength": len(binary)}]}).encode()
    text += b" " * (-len(text) % 4)
    with open(path, "wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(binary)))
        file.write(struct.pack("<I4s", len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", len(binary), b"BIN\0") + binary)


def main():
    models = {"candle": candle, "plastics": plastics}
    if len(sys.argv) != 3 or sys.argv[1] not in models:
        sys.exit(__doc__)
    write(sys.argv[2], models[sys.argv[1]]())


if __name__ == "__main__":
    main()
