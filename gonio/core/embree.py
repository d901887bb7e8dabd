"""The gateway to Embree: the only module that knows it.

embreex ships Embree 4 inside its wheel. Its Python interface traces one ray at a time on one thread, so
we bind the library's documented C interface with ctypes, build scenes from Python and trace from numba
kernels: a kernel receives a `Handle` of run-time integers (function addresses and the scene) and calls
through them. Integers, because a ctypes function held as a global would keep numba from caching.

Rays travel in packets of 16, in the memory layout of Embree's ``RTCRayHit16``: a float32 array of shape
(`PACKET_ROWS`, 16) from `new_packet`, one row a field, named by the constants below. The packet is the
state of 16 paths; nothing is copied in or out.
"""

from __future__ import annotations

import ctypes
import importlib.metadata
import threading
import weakref
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.core import jit
from gonio.core.jit import kernel

# Rows of a packet: struct RTCRayHit16 of Embree 4, then the valid mask rtcIntersect16 takes beside it.
ORG_X, ORG_Y, ORG_Z, T_NEAR, DIR_X, DIR_Y, DIR_Z, TIME, T_FAR, MASK, RAY_ID, FLAGS = range(12)
NORMAL_X, NORMAL_Y, NORMAL_Z, HIT_U, HIT_V, PRIM_ID, GEOM_ID, INST_ID, INST_PRIM_ID = range(12, 21)
VALID = 21
PACKET_ROWS = 22
PACKET_WIDTH = 16
MISS = -1
"""GEOM_ID after a ray that hit nothing (RTC_INVALID_GEOMETRY_ID)."""

# Fields of one ray: struct RTCRayHit has the same order, one float each.
SINGLE_FIELDS = 24

_ROBUST = 4
_COHERENT = 1 << 16
_QUALITY_HIGH = 2
_TRIANGLE, _GRID = 0, 2
_BUFFER_INDEX, _BUFFER_VERTEX, _BUFFER_GRID = 0, 1, 8
_FLOAT3, _UINT3, _GRID_FORMAT = 0x9003, 0x5003, 0xA001
_MAX_GRID = 32767


class EmbreeError(RuntimeError):
    """Embree is missing, or reported an error; the message says which call and what Embree said."""


class Handle(NamedTuple):
    """What a kernel needs to trace a scene: addresses as run-time integers."""

    intersect1: int
    intersect16: int
    occluded1: int
    occluded16: int
    scene: int
    coherent: int
    incoherent: int


class _Arguments(ctypes.Structure):
    """struct RTCIntersectArguments, the same as RTCOccludedArguments."""

    _fields_ = (
        ("flags", ctypes.c_int),
        ("feature_mask", ctypes.c_int),
        ("context", ctypes.c_void_p),
        ("filter", ctypes.c_void_p),
        ("intersect", ctypes.c_void_p),
        ("min_width_distance_factor", ctypes.c_float),
    )


_ARGUMENTS = {flags: _Arguments(flags, -1, None, None, None, 0.0) for flags in (0, _COHERENT)}


class _GridPrimitive(ctypes.Structure):
    """struct RTCGrid."""

    _fields_ = (
        ("start_vertex", ctypes.c_uint32),
        ("stride", ctypes.c_uint32),
        ("width", ctypes.c_uint16),
        ("height", ctypes.c_uint16),
    )


_POINTER, _UINT, _INT, _SIZE = ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_size_t
_SIGNATURES: dict[str, tuple] = {
    "rtcNewDevice": (_POINTER, ctypes.c_char_p),
    "rtcReleaseDevice": (None, _POINTER),
    "rtcGetDeviceError": (_INT, _POINTER),
    "rtcSetDeviceErrorFunction": (None, _POINTER, _POINTER, _POINTER),
    "rtcNewScene": (_POINTER, _POINTER),
    "rtcReleaseScene": (None, _POINTER),
    "rtcSetSceneFlags": (None, _POINTER, _INT),
    "rtcSetSceneBuildQuality": (None, _POINTER, _INT),
    "rtcCommitScene": (None, _POINTER),
    "rtcAttachGeometry": (_UINT, _POINTER, _POINTER),
    "rtcNewGeometry": (_POINTER, _POINTER, _INT),
    "rtcReleaseGeometry": (None, _POINTER),
    "rtcCommitGeometry": (None, _POINTER),
    "rtcSetSharedGeometryBuffer": (None, _POINTER, _INT, _UINT, _INT, _POINTER, _SIZE, _SIZE, _SIZE),
    "rtcIntersect1": (None, _POINTER, _POINTER, _POINTER),
    "rtcIntersect16": (None, _POINTER, _POINTER, _POINTER, _POINTER),
    "rtcOccluded1": (None, _POINTER, _POINTER, _POINTER),
    "rtcOccluded16": (None, _POINTER, _POINTER, _POINTER, _POINTER),
}
_ErrorFunction = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p)
_ERROR_NAMES = {1: "unknown error", 2: "invalid argument", 3: "invalid operation", 4: "out of memory",
                5: "unsupported CPU", 6: "cancelled"}  # fmt: skip


def library_path() -> Path:
    """Path of the Embree 4 library bundled with embreex.

    Raises
    ------
    EmbreeError
        If embreex is not installed or its distribution carries no Embree library.
    """
    remedy = "install a wheel: python -m pip install --force-reinstall --only-binary :all: embreex"
    try:
        distribution = importlib.metadata.distribution("embreex")
    except importlib.metadata.PackageNotFoundError:
        raise EmbreeError(f"embreex is not installed, and Embree comes with it; {remedy}") from None
    for file in distribution.files or ():
        if "embree4" in file.name and any(s in file.name for s in (".so", ".dylib", ".dll")):
            return Path(str(file.locate()))
    raise EmbreeError(
        f"embreex {distribution.version} carries no Embree 4 library (a build without bundled library); {remedy}"
    )


@lru_cache
def _library() -> ctypes.CDLL:
    path = library_path()
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise EmbreeError(f"{path}: cannot be loaded as a library: {error}") from None
    for name, (result, *arguments) in _SIGNATURES.items():
        try:
            function = getattr(library, name)
        except AttributeError:
            raise EmbreeError(f"{path}: has no {name}; Embree 4 is needed") from None
        function.restype, function.argtypes = result, arguments
    return library


class _Device:
    """One Embree device, for the life of the process, and the errors it reported."""

    def __init__(self) -> None:
        self.library = _library()
        self._errors: list[str] = []
        self._lock = threading.Lock()
        # Embree may call this from a thread of its own; an exception cannot pass through C, so it is kept.
        self._callback = _ErrorFunction(self._report)
        self.pointer = self.library.rtcNewDevice(b"")
        if not self.pointer:
            code = self.library.rtcGetDeviceError(None)
            raise EmbreeError(f"rtcNewDevice: {_ERROR_NAMES.get(code, code)}")
        self.library.rtcSetDeviceErrorFunction(self.pointer, self._callback, None)

    def _report(self, _user: int, code: int, message: bytes) -> None:
        with self._lock:
            self._errors.append(
                f"{_ERROR_NAMES.get(code, code)}: {(message or b'').decode(errors='replace')}"
            )

    def call(self, name: str, *arguments: object) -> int:
        """Call a function of the interface and raise what Embree reported meanwhile."""
        result = getattr(self.library, name)(*arguments)
        with self._lock:
            errors, self._errors = self._errors, []
        if errors:
            raise EmbreeError(f"{name}: {'; '.join(errors)}")
        return result


@lru_cache
def _device() -> _Device:
    return _Device()


class Scene:
    """A committed Embree scene (robust mode). Its memory is released when the object is.

    Add geometry with `add_triangles` and `add_grid`, then `commit`; after that it is ready to trace.
    Keep the Scene alive while a kernel uses its `handle`.

    Raises
    ------
    EmbreeError
        Whatever Embree reports, as an exception of the call that caused it.
    """

    def __init__(self) -> None:
        self._device = _device()
        self._pointer = self._device.call("rtcNewScene", self._device.pointer)
        self._buffers: list[object] = []  # shared with Embree, not copied: they live as long as the scene
        weakref.finalize(self, self._device.library.rtcReleaseScene, self._pointer)
        self._device.call("rtcSetSceneFlags", self._pointer, _ROBUST)
        self._committed = False

    def add_triangles(self, vertices: ArrayLike, faces: ArrayLike) -> int:
        """Add a triangle mesh.

        Parameters
        ----------
        vertices : array_like, shape (V, 3)
            Stored as float32: centre and scale first.
        faces : array_like, shape (F, 3)
            Vertex indices, counter-clockwise about the outward normal.

        Returns
        -------
        int
            The geometry's id, in GEOM_ID of its hits.
        """
        faces = np.ascontiguousarray(faces, np.uint32)
        if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) == 0:
            raise EmbreeError(f"add_triangles: faces have shape {faces.shape}; (F, 3) with F > 0 is needed")
        vertices = np.asarray(vertices)
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise EmbreeError(f"add_triangles: vertices have shape {vertices.shape}; (V, 3) is needed")
        if int(faces.max()) >= len(vertices):
            raise EmbreeError(f"add_triangles: face index {faces.max()} with {len(vertices)} vertices")
        buffers = (
            (_BUFFER_VERTEX, _FLOAT3, _padded(vertices), 12, len(vertices)),
            (_BUFFER_INDEX, _UINT3, faces, 12, len(faces)),
        )
        return self._attach(_TRIANGLE, buffers)

    def add_grid(self, vertices: ArrayLike) -> int:
        """Add a grid of vertices, one quad between each four (split from (i+1, j) to (i, j+1)).

        Parameters
        ----------
        vertices : array_like, shape (nx + 1, ny + 1, 3)
            With x growing along the first axis and y along the second, normals point to +z.

        Returns
        -------
        int
            The geometry's id.
        """
        corners: NDArray = np.asarray(vertices)
        sides = corners.shape[:2]
        if corners.ndim != 3 or corners.shape[2] != 3 or not all(2 <= n <= _MAX_GRID for n in sides):
            raise EmbreeError(
                f"add_grid: vertices have shape {corners.shape}; (nx + 1, ny + 1, 3) with 2 to {_MAX_GRID} "
                "vertices a side is needed"
            )
        corners = corners.transpose(1, 0, 2)  # Embree's normals point up when x runs fastest
        rows, columns = corners.shape[:2]
        grid = (_GridPrimitive * 1)(_GridPrimitive(0, columns, columns, rows))
        buffers = (
            (_BUFFER_VERTEX, _FLOAT3, _padded(corners.reshape(-1, 3)), 12, rows * columns),
            (_BUFFER_GRID, _GRID_FORMAT, grid, ctypes.sizeof(_GridPrimitive), 1),
        )
        return self._attach(_GRID, buffers)

    def commit(self) -> Scene:
        """Build the acceleration structure; returns the scene itself, ready to trace."""
        self._device.call("rtcSetSceneBuildQuality", self._pointer, _QUALITY_HIGH)
        self._device.call("rtcCommitScene", self._pointer)
        self._committed = True
        return self

    @property
    def handle(self) -> Handle:
        """Addresses for kernels; valid while this Scene lives."""
        if not self._committed:
            raise EmbreeError("scene.handle: the scene is not committed; call commit() after adding geometry")
        library = self._device.library

        def address(function: str) -> int:
            return ctypes.cast(getattr(library, function), ctypes.c_void_p).value or 0

        return Handle(
            intersect1=address("rtcIntersect1"),
            intersect16=address("rtcIntersect16"),
            occluded1=address("rtcOccluded1"),
            occluded16=address("rtcOccluded16"),
            scene=self._pointer,
            coherent=ctypes.addressof(_ARGUMENTS[_COHERENT]),
            incoherent=ctypes.addressof(_ARGUMENTS[0]),
        )

    def _attach(self, kind: int, buffers: tuple) -> int:
        call = self._device.call
        geometry = call("rtcNewGeometry", self._device.pointer, kind)
        try:
            for slot, layout, data, stride, count in buffers:
                address = data.ctypes.data if isinstance(data, np.ndarray) else ctypes.addressof(data)
                call("rtcSetSharedGeometryBuffer", geometry, slot, 0, layout, address, 0, stride, count)
                self._buffers.append(data)
            call("rtcCommitGeometry", geometry)
            return call("rtcAttachGeometry", self._pointer, geometry)
        finally:
            call("rtcReleaseGeometry", geometry)


def _padded(vertices: NDArray) -> NDArray[np.float32]:
    """Float32 copy with one vertex to spare: Embree reads 16 bytes at a time."""
    if not np.all(np.isfinite(vertices)):
        raise EmbreeError("vertices: some are not finite; NaN and infinite coordinates cannot be traced")
    buffer = np.zeros((len(vertices) + 1, 3), np.float32)
    buffer[:-1] = vertices
    return buffer


if jit.disabled:
    _PROTOTYPES = {n: ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * n) for n in (3, 4)}

    def _call3(address, *words):
        _PROTOTYPES[3](address)(*map(int, words))

    def _call4(address, *words):
        _PROTOTYPES[4](address)(*map(int, words))

else:
    from llvmlite import ir
    from numba import types
    from numba.extending import intrinsic

    def _call(context, builder, _signature, arguments):
        """Call the C function at the address arguments[0] with the rest, all pointers as integers."""
        word = ir.IntType(64)
        function = ir.FunctionType(ir.VoidType(), [word] * (len(arguments) - 1))
        pointer = builder.inttoptr(arguments[0], ir.PointerType(function))
        builder.call(pointer, arguments[1:])
        return context.get_dummy_value()

    @intrinsic
    def _call3(_typing, address, a, b, c):
        return types.void(*[types.intp] * 4), _call

    @intrinsic
    def _call4(_typing, address, a, b, c, d):
        return types.void(*[types.intp] * 5), _call


@kernel
def intersect16(handle, packet, coherent):
    """Nearest hit of the packet's 16 rays whose VALID row is -1; fills NORMAL_*, PRIM_ID, GEOM_ID, T_FAR.

    Before each call set T_FAR to the ray's end and GEOM_ID and INST_ID to MISS. `coherent` rays (similar
    origins and directions) are traced together, which is up to three times faster for them.
    """
    address = packet.ctypes.data
    arguments = handle.coherent if coherent else handle.incoherent
    _call4(handle.intersect16, address + VALID * PACKET_WIDTH * 4, handle.scene, address, arguments)


@kernel
def occluded16(handle, packet, coherent):
    """Whether anything lies between T_NEAR and T_FAR of the rays whose VALID row is -1: T_FAR is then below 0."""
    address = packet.ctypes.data
    arguments = handle.coherent if coherent else handle.incoherent
    _call4(handle.occluded16, address + VALID * PACKET_WIDTH * 4, handle.scene, address, arguments)


@kernel
def intersect1(handle, ray):
    """Nearest hit of one ray; `ray` is a float32 array from `new_ray`, fields as a packet's rows."""
    _call3(handle.intersect1, handle.scene, ray.ctypes.data, handle.incoherent)


@kernel
def occluded1(handle, ray):
    """Whether anything lies between T_NEAR and T_FAR of one ray; T_FAR is overwritten."""
    _call3(handle.occluded1, handle.scene, ray.ctypes.data, handle.incoherent)
    return ray[T_FAR] < 0


@kernel
def new_packet():
    """An idle packet: float32, shape (PACKET_ROWS, 16), aligned to 64 bytes as rtcIntersect16 demands."""
    size = PACKET_ROWS * PACKET_WIDTH
    memory = np.zeros(size + 16, np.float32)
    first = (-memory.ctypes.data % 64) // 4
    packet = memory[first : first + size].reshape((PACKET_ROWS, PACKET_WIDTH))
    packet.view(np.int32)[MASK, :] = -1
    return packet


@kernel
def new_ray():
    """An idle ray: float32, shape (SINGLE_FIELDS,), aligned to 16 bytes as rtcIntersect1 demands."""
    memory = np.zeros(SINGLE_FIELDS + 16, np.float32)
    first = (-memory.ctypes.data % 64) // 4
    ray = memory[first : first + SINGLE_FIELDS]
    ray.view(np.int32)[MASK] = -1
    return ray
