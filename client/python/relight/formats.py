# SPDX-License-Identifier: MIT
"""Colours and coefficients of the protocol as arrays."""
from __future__ import annotations

from typing import Any, Dict, List, NamedTuple, Tuple

import numpy as np
import numpy.typing as npt

from .errors import RelightError

Floats = npt.NDArray[np.float32]
U_UNIT = np.float32(2.0 ** -20)
MOST_RANK = 1 << 20


def rgb9e5(words: npt.NDArray[np.uint32]) -> Floats:
    """[n] packed colours to [n, 3] linear RGB."""
    scale = np.ldexp(np.float32(1), (words >> 27).astype(np.int32) - 24)
    channels = np.stack([words & 511, words >> 9 & 511, words >> 18 & 511], axis=-1)
    out: Floats = (channels * scale[..., None]).astype(np.float32)
    return out


def srgb8(values: npt.NDArray[np.uint8]) -> Floats:
    """[n, 4] sRGB bytes to [n, 3] linear RGB in [0, 1]."""
    x = values[..., :3].astype(np.float32) / 255
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4).astype(np.float32)


def plane(format: str, payload: bytes, begin: int, n_vertex: int) -> Floats:
    """One plane of colours, [n_vertex, 3]."""
    if format == "f32":
        return np.frombuffer(payload, "<f4", 3 * n_vertex, begin).reshape(-1, 3).astype(np.float32)
    if format == "f16":
        return np.frombuffer(payload, "<f2", 3 * n_vertex, begin).reshape(-1, 3).astype(np.float32)
    if format == "rgb9e5":
        return rgb9e5(np.frombuffer(payload, "<u4", n_vertex, begin))
    return srgb8(np.frombuffer(payload, "u1", 4 * n_vertex, begin).reshape(-1, 4))


class Tensor(NamedTuple):
    single: bool
    clusters: npt.NDArray[np.uint32]  # [n_cluster, 2] vertices, rank
    order: npt.NDArray[np.uint32]  # [n_vertex] file vertex at each position
    blocks: List[Floats]  # of each cluster, [vertices, columns]


class Factors(NamedTuple):
    hash: int
    n_vertex: int
    tensors: List[Tensor]


def factors(message: Any, payload: bytes) -> Factors:
    """The answer to FACTORS, checked (PROTOCOL.md, "FACTORS and coefficients")."""
    tensors = []
    for t in message.tensors:
        clusters = np.frombuffer(payload, "<u4", 2 * t.n_cluster, t.clusters_offset).reshape(-1, 2)
        order = np.frombuffer(payload, "<u4", message.n_vertex, t.order_offset)
        numbers = np.frombuffer(payload, "<i2", t.u_bytes // 2, t.u_offset)
        blocks, at = [], 0
        if not np.array_equal(np.sort(order), np.arange(message.n_vertex)) or (clusters[:, 1] > MOST_RANK).any():
            raise RelightError("PROTOCOL", "factors answer: a vertex is not in one cluster")
        for n, rank in clusters.tolist():
            pairs, stride = (rank + 1) // 2, -(-n // 16) * 16
            block = numbers[at:at + 2 * pairs * stride].reshape(pairs, stride, 2)
            at += 2 * pairs * stride
            columns = block.transpose(1, 0, 2).reshape(stride, 2 * pairs)[:n, :rank]
            blocks.append(columns.astype(np.float32) * U_UNIT)
        if at != numbers.size or clusters[:, 0].sum() != message.n_vertex:
            raise RelightError("PROTOCOL", "factors answer: clusters and U do not fit together")
        tensors.append(Tensor(t.term == 3, clusters, order, blocks))
    return Factors(message.factors, message.n_vertex, tensors)


def unpack_rows(packed: Any) -> Floats:
    """Triples [n, 3] of the words of COEFFICIENTS_PACKED (PROTOCOL.md), n even."""
    mantissas = (packed[:, None] >> np.array([0, 10, 20], np.uint32) & 1023).astype(np.int32)
    signed = mantissas - 1024 * (mantissas >> 9)
    exponents = (packed[::2] >> 30 | packed[1::2] >> 30 << 2).astype(np.int32)
    return np.ldexp(signed.astype(np.float32), np.repeat(exponents, 2)[:, None] - 9)


def expand(f: Factors, coefficients: Any, payload: bytes, begin: int, plane_index: int,
           packed: bool = False) -> Tuple[Floats, Floats]:
    """The sums M [n, 3] and S [n_phase, n, 3] of one plane; packed: of COEFFICIENTS_PACKED."""
    if coefficients.factors != f.hash:
        raise RelightError("MISMATCH", "these coefficients belong to the factors of another bake")
    multiple = np.zeros((f.n_vertex, 3), np.float32)
    most = max([layer.n_phase for layer in coefficients.layers], default=1)
    single = np.zeros((most, f.n_vertex, 3), np.float32)
    for layer in coefficients.layers:
        t = f.tensors[layer.tensor]
        count = layer.n_row * layer.n_phase
        if packed:
            words = np.frombuffer(payload, "<u4", count + count % 2, begin + layer.offset)
            rows = unpack_rows(words)[:count]
        else:
            rows = np.frombuffer(payload, "<f2", 3 * count, begin + layer.offset).astype(np.float32)
        b = rows.reshape(layer.n_row, layer.n_phase, 3) * layer.scales[plane_index]
        position = row = 0
        for (n, rank), u in zip(t.clusters.tolist(), t.blocks):
            sent = min(rank, coefficients.most_rank or rank)
            sums = np.tensordot(u[:, :sent], b[row:row + sent], 1)  # [n, n_phase, 3]
            vertices = t.order[position:position + n]
            if t.single:
                single[:layer.n_phase, vertices] += sums.transpose(1, 0, 2)
            else:
                multiple[vertices] += sums[:, 0]
            position, row = position + n, row + sent
    return multiple, single


def colors_of(f: Factors, coefficients: Any, payload: bytes, begin: int, plane_index: int,
              blocks: Any, packed: bool = False) -> Floats:
    """The colours without an eye that the daemon would have sent."""
    multiple, single = expand(f, coefficients, payload, begin, plane_index, packed)
    out = np.maximum(multiple, 0)
    for i, block in enumerate(blocks):
        part = slice(block.vertex_begin, block.vertex_begin + block.n_vertex)
        if not block.translucent:
            if block.HasField("gain"):
                out[part] *= np.array([block.gain.x, block.gain.y, block.gain.z], np.float32)
            continue
        outgoing = coefficients.outgoing[i if len(coefficients.outgoing) > 1 else 0]
        out[part] = np.maximum(0, outgoing.mean * (multiple[part] + single[0, part]))
    return out


Cache = Dict[Tuple[str, str], Tuple[Factors, Any]]
