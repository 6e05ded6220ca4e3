# SPDX-License-Identifier: MIT
"""relight.Client: connect, upload, relight, edit, follow a view."""
from __future__ import annotations

import hashlib
import json
import os
import time
from dataclasses import dataclass, field
from types import TracebackType
from typing import (Any, Callable, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple, Type,
                    Union)

import numpy as np
import numpy.typing as npt

from . import formats
from .connection import Connection, Frame, default_address
from .errors import RelightError
from .formats import Floats
from .messages import enum, message, word
from .model_files import named_files

Vector = Sequence[float]
Light = Union[str, os.PathLike[str], npt.NDArray[np.float32]]
Material = Union[str, Dict[str, Any]]
ENV_ENDINGS = (".hdr", ".exr", ".png", ".jpg", ".jpeg", ".dds", ".pfm", ".pic", ".ktx")
GRACE = 2.0  # seconds that the daemon has to answer that a deadline has passed


@dataclass(frozen=True)
class Progress:
    """stage: "upload" or a stage of the bake. fraction: in [0, 1]. eta: seconds, None: unknown."""
    stage: str
    fraction: float
    eta: Optional[float] = None


ProgressFn = Callable[[Progress], Optional[bool]]


def _is_file(path: str) -> bool:
    """Whether it can be read as one, as a pipe can. A folder of a preset's name cannot."""
    return os.path.exists(path) and not os.path.isdir(path)


@dataclass(frozen=True)
class Server:
    name: str
    run: str
    principal: str
    scopes: Tuple[str, ...]
    features: Tuple[str, ...]
    presets: Tuple[str, ...]
    chunk: int


@dataclass(frozen=True)
class Environment:
    env: str  # "env:HASH", for the env of requests
    name: str
    bytes: int


@dataclass(frozen=True)
class Model:
    """state: "ready", "baking", "preview", "unloaded", "failed", "received"."""
    id: str
    name: str
    state: str
    n_vertex: int
    n_triangle: int
    engine: str
    storage: str
    mm_per_unit: float
    generation: int
    error_bound: float
    material: Dict[str, Any] = field(default_factory=dict)
    settings: Dict[str, Any] = field(default_factory=dict)
    warnings: Tuple[str, ...] = ()
    variants: Tuple[str, ...] = ()  # names for `variant` of colors, image and view


@dataclass(frozen=True)
class Geometry:
    """positions [n, 3] in mm, or the model's units; normals [n, 3]; triangles [t, 3]."""
    positions: Floats
    normals: Floats
    triangles: npt.NDArray[np.uint32]
    mm_per_unit: float
    generation: int


@dataclass(frozen=True)
class Image:
    """data: the bytes of the file; of format "f16" and "rgb8" see pixels."""
    data: bytes
    width: int
    height: int
    format: str
    engine: str
    note: str
    error_bound: float

    @property
    def pixels(self) -> npt.NDArray[Any]:
        """[height, width, 3], top row first: format "f16" linear float32, "rgb8" bytes."""
        if self.format == "f16":
            return np.frombuffer(self.data, "<f2").reshape(self.height, self.width, 3).astype(np.float32)
        if self.format == "rgb8":
            return np.frombuffer(self.data, "u1").reshape(self.height, self.width, 3)
        raise ValueError("pixels are of the formats f16 and rgb8, not of " + self.format)


@dataclass(frozen=True)
class Link:
    url: str  # path and query: put it behind the address of the daemon's HTTP
    expires_s: int


@dataclass(frozen=True)
class ViewFrame:
    """colors [n, 3] or image, by the kind of the view. sequence: the newest state in it."""
    frame: int
    sequence: int
    colors: Optional[Floats]
    image: Optional[Image]
    reduced: int


def _vec3(v: Vector) -> Any:
    x, y, z = (float(c) for c in v)
    return message("Vec3", x=x, y=y, z=z)


def _orbit(orbit: Vector) -> Any:
    azimuth, elevation, *zoom = orbit
    return message("Orbit", azimuth_deg=azimuth, elevation_deg=elevation, zoom=zoom[0] if zoom else 0)


def _parse(text: str) -> Dict[str, Any]:
    found: Dict[str, Any] = json.loads(text) if text else {}
    return found


def _model(m: Any) -> Model:
    return Model(m.model, m.name, word("ModelState", "MODEL_", m.state), m.n_vertex, m.n_triangle,
                 word("Engine", "ENGINE_", m.engine), word("Storage", "STORAGE_", m.storage),
                 m.mm_per_unit, m.generation, m.error_bound, _parse(m.material), _parse(m.settings),
                 tuple(m.warnings), tuple(m.variants))


class Client:
    """A connection to a relightd. One thread at a time; several clients may be used at once.

    address: "tcp:HOST[:PORT]", "tls:HOST[:PORT]" or "unix:PATH", a HOST of IPv6 in brackets; None:
    $RELIGHT_SERVER, else the unix socket of this user's daemon, else port 7413 of this machine.
    token: None: $RELIGHT_TOKEN.
    ca: a PEM file of the certificates that may sign the server's (tls). timeout: seconds for each
    call, sent to the daemon as its deadline; None: wait. Every call raises RelightError.
    """

    def __init__(self, address: Optional[str] = None, *, token: Optional[str] = None,
                 ca: Optional[str] = None, timeout: Optional[float] = None,
                 name: str = "relight-python") -> None:
        self.timeout = timeout
        self._connection = Connection(address or default_address(), ca or os.environ.get("RELIGHT_CA"),
                                      timeout)
        self._factors: formats.Cache = {}
        if token is None:
            token = os.environ.get("RELIGHT_TOKEN", "")
        hello = message("HelloRequest", client=name, version_min=1, version_max=1, token=token)
        try:
            said = self._call("HELLO", hello).message
        except BaseException:
            self.close()
            raise
        self.server = Server(said.server, said.run, said.principal, tuple(said.scopes),
                             tuple(said.features), tuple(said.presets), said.chunk or 1 << 20)

    def close(self) -> None:
        """Ends the connection; views end with it, bakes go on."""
        self._connection.close()

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, kind: Optional[Type[BaseException]], value: Optional[BaseException],
                 trace: Optional[TracebackType]) -> None:
        self.close()

    # ---- requests

    def _call(self, kind: str, request: Any, payload: bytes = b"") -> Frame:
        number = self._connection.send(kind, request, payload, self.timeout)
        return self._wait(number)

    def _wait(self, number: int) -> Frame:
        try:
            return self._connection.next(number, self.timeout and self.timeout + GRACE)
        except TimeoutError:
            self._connection.forget(number)
            raise RelightError("TIMEOUT", "no answer in %g s" % (self.timeout or 0)) from None

    def ping(self) -> float:
        """Seconds of a round trip."""
        begin = time.monotonic()
        self._call("PING", message("PingRequest"))
        return time.monotonic() - begin

    # ---- uploads

    def upload(self, data: Union[bytes, str, os.PathLike[str]], name: str = "",
               progress: Optional[ProgressFn] = None) -> str:
        """Uploads bytes or a file, unless the daemon has them; the SHA-256 that names them.

        progress: called between chunks; a true result stops (RelightError CANCELLED).
        """
        if not isinstance(data, bytes):
            name = name or os.path.basename(os.fspath(data))
            with open(data, "rb") as f:
                data = f.read()
        named = hashlib.sha256(data).hexdigest()
        ask = {"hash": named, "size": len(data), "name": name}
        state = self._call("PUT_BLOB", message("PutBlobRequest", **ask)).message
        while not state.complete:
            at = int(state.received)
            if progress and progress(Progress("upload", at / max(1, len(data)))):
                raise RelightError("CANCELLED", "the upload was stopped")
            chunk = data[at:at + self.server.chunk]
            state = self._call("PUT_BLOB", message("PutBlobRequest", offset=at, **ask), chunk).message
        if progress:
            progress(Progress("upload", 1.0))
        return named

    def environment(self, env: Union[str, os.PathLike[str]]) -> str:
        """What requests name a light by: a file is uploaded; other words are returned."""
        text = os.fspath(env)
        if text.startswith(("env:", "name:", "constant")):
            return text
        if _is_file(text) or text.lower().endswith(ENV_ENDINGS):
            return "env:" + self.upload(text)
        return "name:" + text

    def environments(self) -> List[Environment]:
        """The images that this client uploaded, most recently used first."""
        found = self._call("LIST", message("ListRequest", environments=True)).message
        return [Environment(e.env, e.name, e.bytes) for e in found.environments]

    # ---- models

    def models(self) -> List[Model]:
        """The models that the daemon holds for this client."""
        found: List[Model] = []
        after = 0
        while True:  # an answer has 256 models at most
            said = self._call("LIST", message("ListRequest", after=after)).message
            found.extend(_model(m) for m in said.models)
            after = said.next
            if not after:
                return found

    def files(self) -> List[str]:
        """Paths of the daemon's models folder, for load(path=...)."""
        return [f.path for f in self._call("LIST", message("ListRequest", files=True)).message.files]

    def info(self, model: str) -> Model:
        """model: an id, the beginning of one, or a name."""
        return _model(self._call("INFO", message("InfoRequest", model=model)).message)

    def load(self, file: Union[str, os.PathLike[str], None] = None, *, path: Optional[str] = None,
             size_mm: Optional[float] = None, mm_per_unit: Optional[float] = None,
             material: Optional[Material] = None, name: str = "", preview: bool = False,
             draft: bool = True, wait: bool = True, progress: Optional[ProgressFn] = None,
             materials: Optional[Mapping[str, Material]] = None, opaque: Sequence[str] = (), variant: str = "",
             up_z: bool = False, flip_v: bool = False, **bake: Any) -> str:
        """Uploads and loads a model (file), or loads one of the daemon's folder (path); its id.

        With a .gltf go its buffers and images, with an .obj its material library and the images of that.
        Without a material the bake leaves it open (joint transport). materials: those of single
        objects, by the name of a glTF material or node. preview: no bake, pictures
        come from the image-space engines. draft: a draft answers until the bake is done. wait: until
        the bake is done; progress is called as in upload. opaque: names of materials or nodes. variant:
        of the glTF's materials. up_z: +z is up in the file. flip_v: its images lie upside down. bake:
        fields of BakeSettings, such as samples=50000, transport="wavelet" or scattering="walk".
        """
        request = message("LoadRequest", name=name, preview=preview, no_draft=not draft,
                          variant=variant, up_z=up_z, flip_v=flip_v, opaque=opaque)
        if (file is None) == (path is None):
            raise RelightError("ARGUMENT", "load takes either a file to upload or a path at the daemon")
        if file is not None:
            whole = os.fspath(file)
            for own, full in [(os.path.basename(whole), whole), *named_files(whole)]:
                request.files.append(message("FileRef", name=own, blob=self.upload(full, progress=progress)))
        else:
            request.path = path
        if size_mm is not None:
            request.size_mm = size_mm
        if mm_per_unit is not None:
            request.mm_per_unit = mm_per_unit
        request.material = self._material(material)
        request.materials.extend(self._materials(materials))
        for key, value in bake.items():
            if key in ("transport", "storage", "scattering"):
                value = enum(key.capitalize(), key.upper() + "_", value)
            try:
                setattr(request.bake, key, value)
            except (AttributeError, TypeError, ValueError) as fault:
                raise RelightError("ARGUMENT", "%s=%r: %s" % (key, value, fault)) from fault
        loaded = self._call("LOAD", request).message
        if wait and loaded.job:
            self.watch(loaded.job, progress)
        return str(loaded.model)

    def watch(self, job: str, progress: Optional[ProgressFn] = None) -> None:
        """Waits for a bake: a job's id, or a model's. A true result of progress stops waiting."""
        number = self._connection.send("WATCH", message("WatchRequest", job=job))
        while True:
            frame = self._connection.next(number, None)
            state = word("JobState", "JOB_", frame.message.state)
            if progress and state == "running":
                eta = frame.message.eta_s
                if progress(Progress(frame.message.stage, frame.message.fraction, eta if eta >= 0 else None)):
                    self._call("CANCEL", message("CancelRequest", id=number))
                    self._connection.forget(number)
                    raise RelightError("CANCELLED", "nobody waits any more; the bake goes on")
            if state == "failed":
                raise RelightError.of_message(frame.message.error)
            if state == "cancelled":
                raise RelightError("CANCELLED", "the bake was cancelled")
            if frame.last:
                return

    def unload(self, model: str, forget: bool = False, force: bool = False) -> None:
        """Frees a model's memory; forget: its bake, too; force: also where review rooms need it."""
        self._call("UNLOAD", message("UnloadRequest", model=model, forget=forget, force=force))

    def geometry(self, model: str, own_units: bool = False) -> Geometry:
        """Positions, normals and triangles, in the order of colours."""
        frame = self._call("GEOMETRY", message("GeometryRequest", model=model, own_units=own_units))
        m, n, p = frame.message, 3 * frame.message.n_vertex, frame.payload
        return Geometry(np.frombuffer(p, "<f4", n, m.positions_offset).reshape(-1, 3),
                        np.frombuffer(p, "<f4", n, m.normals_offset).reshape(-1, 3),
                        np.frombuffer(p, "<u4", 3 * m.n_triangle, m.triangles_offset).reshape(-1, 3),
                        m.mm_per_unit, m.generation)

    # ---- light

    def _material(self, material: Optional[Material]) -> str:
        if isinstance(material, dict):
            return json.dumps(material)
        if material and _is_file(material):
            with open(material, encoding="utf-8") as f:
                return f.read()
        return material or ""

    def _materials(self, materials: Optional[Mapping[str, Material]]) -> List[Any]:
        return [message("ObjectMaterial", object=name, material=self._material(one))
                for name, one in (materials or {}).items()]

    def _lights(self, env: Union[Light, Sequence[Light], None], rotate: Union[float, Sequence[float]],
                gain: Union[float, Vector, None]) -> Tuple[List[Any], bytes]:
        """A light is a word, a file, or an array [6, n, n, 3] of radiance."""
        words: Sequence[Any] = env if isinstance(env, (list, tuple)) else [] if env is None else [env]
        turns = list(rotate) if isinstance(rotate, (list, tuple)) else [rotate] * len(words)
        if len(turns) != len(words):
            raise RelightError("ARGUMENT", "%d rotations for %d lights" % (len(turns), len(words)))
        lights, payload = [], b""
        for one, turn in zip(words, turns):
            light = message("Light", rotate_deg=float(turn))
            if isinstance(one, np.ndarray):
                if one.ndim != 4 or one.shape[0] != 6 or one.shape[1] != one.shape[2] or one.shape[3] != 3:
                    raise RelightError("ARGUMENT", "a light's array has the shape [6, n, n, 3], not %s"
                                       % (list(one.shape),))
                light.cube_n = one.shape[1]
                payload += np.ascontiguousarray(one, "<f4").tobytes()
            else:
                light.env = self.environment(one)
            if gain is not None:
                light.gain.CopyFrom(_vec3([gain] * 3 if isinstance(gain, (int, float)) else gain))
            lights.append(light)
        return lights, payload

    def _shade(self, material: Optional[Material], term: str, eye: Optional[Vector], engine: str,
               max_error: float, materials: Optional[Mapping[str, Material]] = None,
               variant: str = "") -> Any:
        shade = message("Shade", material=self._material(material), term=enum("Term", "TERM_", term),
                        variant=variant, materials=self._materials(materials), engine=enum("Engine", "ENGINE_", engine), max_error=max_error)
        if eye is not None:
            shade.eye.CopyFrom(_vec3(eye))
        return shade

    def colors(self, model: str, env: Union[Light, Sequence[Light], None] = None, *,
               rotate: Union[float, Sequence[float]] = 0.0, gain: Union[float, Vector, None] = None,
               material: Optional[Material] = None, term: str = "total", eye: Optional[Vector] = None,
               sum: bool = True, format: str = "f32", engine: str = "default",
               max_error: float = 0.0, materials: Optional[Mapping[str, Material]] = None,
               variant: str = "") -> Floats:
        """Linear RGB radiance of each vertex, [n, 3]; with sum=False [n_light, n, 3].

        env: "constant", "constant:R,G,B", "env:HASH", the name of an uploaded image, a file, an
        array [6, n, n, 3], or a list of these. rotate: degrees counter-clockwise about +y.
        material: a preset's name, JSON, a JSON file or a dict (joint bakes). materials: those of
        single objects, by the name of a glTF material or node; the others have material. term: "total",
        "multiple", "single" or "irradiance". eye: towards this point, in the model's units.
        variant: one of the model's variants, or "default", the file's own materials.
        format: on the wire: "f32", "f16", "rgb9e5", "srgb8", or "coefficients": small answers,
        which are multiplied here with the bake's factors; these are fetched once.
        "coefficients_packed": the same, rounded to two thirds of the bytes.
        """
        lights, payload = self._lights(env, rotate, gain)
        request = message("ColorsRequest", model=model, lights=lights, sum=sum,
                          shade=self._shade(material, term, eye, engine, max_error, materials, variant),
                          format=enum("ColorFormat", "COLOR_", format))
        planes = self._planes(model, self._call("COLORS", request, payload), format, variant)
        first: Floats = planes[0]
        return first if sum else planes

    def _planes(self, model: str, frame: Frame, format: str, variant: str) -> Floats:
        m = frame.message.colors if frame.message.DESCRIPTOR.name == "ViewFrame" else frame.message
        if format.startswith("coefficients"):
            held, blocks = self._factors_of(model, m.coefficients.factors, variant)
            return np.stack([formats.colors_of(held, m.coefficients, frame.payload, i * m.plane_bytes, i, blocks,
                                               format == "coefficients_packed")
                             for i in range(m.n_plane)])
        return np.stack([formats.plane(format, frame.payload, i * m.plane_bytes, m.n_vertex)
                         for i in range(m.n_plane)])

    def _factors_of(self, model: str, hash: int, variant: str) -> Tuple[formats.Factors, Any]:
        key = (model, variant)
        held = self._factors.get(key)
        if held is None or held[0].hash != hash:
            frame = self._call("FACTORS", message("FactorsRequest", model=model))
            geometry = message("GeometryRequest", model=model, variant=variant, no_normals=True, no_triangles=True)
            blocks = self._call("GEOMETRY", geometry).message.blocks
            held = formats.factors(frame.message, frame.payload), blocks
            self._factors[key] = held
        return held

    def _picture(self, size: Tuple[int, int], format: str, camera: Optional[str], eye: Optional[Vector],
                 target: Optional[Vector], fovy: float, orbit: Optional[Vector], exposure: float,
                 background: Optional[Vector], tone: str, quality: int, samples: int) -> Any:
        picture = message("Picture", width=size[0], height=size[1], exposure_ev=exposure, quality=quality,
                          samples=samples, format=enum("ImageFormat", "IMAGE_", "jpeg" if format == "jpg" else format),
                          tone=enum("Tone", "TONE_", tone))
        if background is not None:
            picture.plain_background = True
            picture.background.CopyFrom(_vec3(background))
        if orbit is not None:
            picture.camera.orbit.CopyFrom(_orbit(orbit))
        elif camera is not None:
            picture.camera.name = camera
        elif eye is not None and target is not None:
            picture.camera.CopyFrom(message("Camera", eye=_vec3(eye), target=_vec3(target), fovy_deg=fovy))
        elif eye is not None or target is not None:
            raise RelightError("ARGUMENT", "a camera has both eye and target")
        return picture

    def image(self, model: str, env: Union[Light, Sequence[Light], None] = None, *,
              size: Tuple[int, int] = (800, 600), format: str = "png",
              rotate: Union[float, Sequence[float]] = 0.0, gain: Union[float, Vector, None] = None,
              material: Optional[Material] = None, term: str = "total", engine: str = "default",
              camera: Optional[str] = None, eye: Optional[Vector] = None, target: Optional[Vector] = None,
              fovy: float = 0.0, orbit: Optional[Vector] = None, exposure: float = 0.0,
              background: Optional[Vector] = None, tone: str = "filmic", quality: int = 0,
              samples: int = 0, max_error: float = 0.0, floor: bool = False,
              materials: Optional[Mapping[str, Material]] = None, variant: str = "") -> Image:
        """A picture. format: a word of ImageFormat ("png", "jpg", "exr", or raw pixels
        "f16", linear, and "rgb8").

        The camera frames the model, or is one of the model's file (camera), or looks from eye to
        target (the model's units), or from orbit: azimuth, elevation[, zoom] in degrees. Lights and
        materials as in colors; the first light is the background unless background is given.
        floor: with the shadow of the model on a plane under it. variant: as in colors.
        """
        lights, payload = self._lights(env, rotate, gain)
        request = message("ImageRequest", model=model, lights=lights,
                          shade=self._shade(material, term, None, engine, max_error, materials, variant),
                          picture=self._picture(size, format, camera, eye, target, fovy, orbit, exposure,
                                                background, tone, quality, samples))
        request.picture.floor = floor
        return self._image(self._call("IMAGE", request, payload), format)

    @staticmethod
    def _image(frame: Frame, format: str) -> Image:
        m = frame.message.image if frame.message.DESCRIPTOR.name == "ViewFrame" else frame.message
        return Image(frame.payload, m.width, m.height, format, word("Engine", "ENGINE_", m.cost.engine),
                     m.cost.note, m.cost.error_bound)

    def edit(self, model: str, material: Material, env: Union[Light, Sequence[Light], None] = None,
             **options: Any) -> Floats:
        """Colours of a model in another medium, without a bake: colors() with its options."""
        return self.colors(model, env, material=material, **options)

    def view(self, model: str, env: Light, *, rotate: float = 0.0, material: Optional[Material] = None,
             format: str = "rgb9e5", colors: bool = True, max_fps: int = 0,
             size: Tuple[int, int] = (800, 600), orbit: Optional[Vector] = None,
             materials: Optional[Mapping[str, Material]] = None, variant: str = "") -> "View":
        """A live view: a state that frames follow, newest state first.

        Frames are colours in one of the formats of colors(), or with colors=False JPEG pictures.
        """
        lights, payload = self._lights(env, rotate, None)
        options = message("ViewOptions", max_fps=max_fps, window=2,
                          color_format=enum("ColorFormat", "COLOR_", format if colors else "f32"))
        state = message("ViewState", lights=lights, options=options,
                        shade=self._shade(material, "total", None, "default", 0, materials, variant))
        if not colors:
            state.picture.CopyFrom(self._picture(size, "jpeg", None, None, None, 0, orbit, 0, None, "filmic", 0, 0))
        request = message("ViewOpenRequest", model=model, state=state, colors=colors)
        number = self._connection.send("VIEW_OPEN", request, payload)
        return View(self, model, number, format, colors, variant)

    def sign(self, url: str, lifetime: float = 86400.0) -> Link:
        """A link to a picture ("/v1/models/bunny/image.jpg?...") that expires and needs no token."""
        answer = self._call("SIGN", message("SignRequest", url=url, lifetime_s=int(lifetime))).message
        return Link(answer.url, answer.expires_s)


class View:
    """Of Client.view. Iterating gives frames; close it, or use it in a with statement."""

    def __init__(self, client: Client, model: str, number: int, format: str, colors: bool,
                 variant: str = "") -> None:
        self._client, self._model, self._number, self._variant = client, model, number, variant
        self._format, self._colors = format, colors
        self._sequence = 0
        self.open = True

    def __enter__(self) -> "View":
        return self

    def __exit__(self, kind: Optional[Type[BaseException]], value: Optional[BaseException],
                 trace: Optional[TracebackType]) -> None:
        self.close()

    def __iter__(self) -> Iterator[ViewFrame]:
        while self.open:
            yield self.next()

    def set(self, *, rotate: Optional[float] = None, material: Optional[Material] = None,
            orbit: Optional[Vector] = None, exposure: Optional[float] = None,
            materials: Optional[Mapping[str, Material]] = None) -> int:
        """Changes the state; what is not given stays. Its number, which frames repeat."""
        client = self._client
        state = message("ViewState")
        if rotate is not None:
            state.lights.append(message("Light", rotate_deg=rotate))
            state.fields.append("lights.rotate_deg")
        if material is not None:
            state.shade.material = client._material(material)
            state.fields.append("shade.material")
        if materials is not None:
            state.shade.materials.extend(client._materials(materials))
            state.fields.append("shade.materials")
        if orbit is not None:
            state.picture.camera.orbit.CopyFrom(_orbit(orbit))
            state.fields.append("picture.camera")
        if exposure is not None:
            state.picture.exposure_ev = exposure
            state.fields.append("picture.exposure_ev")
        self._sequence += 1
        client._call("VIEW_SET", message("ViewSetRequest", view=self._number, sequence=self._sequence,
                                         state=state))
        return self._sequence

    def next(self, timeout: Optional[float] = None) -> ViewFrame:
        """Waits for a frame; the newest, where several are here. TimeoutError after timeout."""
        connection = self._client._connection
        if not self.open:
            raise RelightError("CANCELLED", "the view has ended")
        try:
            frame = connection.next(self._number, timeout)
            while not frame.last and connection.pending(self._number):
                frame = connection.next(self._number, timeout)
        except RelightError:
            self.open = False  # the daemon's error ends the view
            raise
        if frame.last:
            self.open = False
            raise RelightError("CANCELLED", "the view has ended")
        m = frame.message
        connection.send("VIEW_ACK", message("ViewAck", view=self._number, shown=m.frame), one_way=True)
        if m.HasField("error"):
            raise RelightError.of_message(m.error)
        if self._colors:
            colors = self._client._planes(self._model, frame, self._format, self._variant)[0]
            return ViewFrame(m.frame, m.sequence, colors, None, m.colors.cost.reduced)
        return ViewFrame(m.frame, m.sequence, None, Client._image(frame, "jpeg"), m.image.cost.reduced)

    def close(self) -> None:
        if self.open and not self._client._connection.broken:
            self._client._call("VIEW_CLOSE", message("ViewCloseRequest", view=self._number))
            self._client._connection.forget(self._number)
        self.open = False
