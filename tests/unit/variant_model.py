# SPDX-License-Identifier: MIT
"""A GLB with KHR_materials_variants: a translucent ball and an opaque one, and five variants. "day"
gives the ball another texture, roughness and emission, "dark" the stone another albedo, "jade" the
ball another medium, "bumpy" a normal map, and "clear" makes the stone translucent."""
import json
import struct

import textured_ball

ALBEDO, DARK = (.5, .4, .3), (.25, .4, .15)


def volume(name, color, texture, albedo=(.7, .6, .5), **more):
    return {'name': name, 'pbrMetallicRoughness': dict({'baseColorTexture': {'index': texture},
                                                   'baseColorFactor': [*albedo, 1]}, **more),
            'extensions': {'KHR_materials_volume': {'attenuationDistance': .008, 'attenuationColor': color}}}


def opaque(name, albedo):
    return {'name': name, 'pbrMetallicRoughness': {'baseColorFactor': [*albedo, 1]}}


SKIN = volume('skin', [.9, .6, .4], 0)
DAY = dict(volume('skin day', [.9, .6, .4], 1, roughnessFactor=.3), emissiveFactor=[.1, .2, 0])
MATERIALS = [SKIN, opaque('stone', ALBEDO), DAY, opaque('stone dark', DARK), volume('jade', [.4, .8, .5], 0, (.3, .7, .3)),
             dict(volume('bumpy', [.9, .6, .4], 0), normalTexture={'index': 2}), volume('glass', [.9, .9, .9], 0)]
VARIANTS = [('day', 0, 2), ('dark', 1, 3), ('jade', 0, 4), ('bumpy', 0, 5), ('clear', 1, 6)]


def write(path, jade_ior=None):
    """jade_ior: the refractive index that the variant "jade" gives the ball; None: as it was."""
    textured_ball.glb(path, [textured_ball.flat(c) for c in ((200, 90, 60), (60, 120, 220), (190, 128, 230))], SKIN,
                      opaque=True)
    with open(path, 'rb') as f:
        data = f.read()
    size = struct.unpack('<I', data[12:16])[0]
    doc, rest = json.loads(data[20:20 + size]), data[20 + size:]
    doc['materials'] = json.loads(json.dumps(MATERIALS))
    if jade_ior:
        doc['materials'][4]['extensions']['KHR_materials_ior'] = {'ior': jade_ior}
    doc['extensions'] = {'KHR_materials_variants': {'variants': [{'name': v[0]} for v in VARIANTS]}}
    for i, mesh in enumerate(doc['meshes']):
        mesh['primitives'][0]['extensions'] = {'KHR_materials_variants': {'mappings': [
            {'material': material, 'variants': [k]} for k, (_, own, material) in enumerate(VARIANTS) if own == i]}}
    text = json.dumps(doc).encode()
    text += b' ' * (-len(text) % 4)
    with open(path, 'wb') as f:
        f.write(struct.pack('<4sIIII', b'glTF', 2, 20 + len(text) + len(rest), len(text), 0x4e4f534a) + text + rest)
