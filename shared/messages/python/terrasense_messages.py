"""Every sample that crosses a process boundary, for services written in Python. Standard library only.

The fields, their units and their meaning are described in `shared/messages/src`; `tests/layout.rs` compares the two,
offset by offset. The field `class` is a word of Python: read it with `getattr(sample, "class")`.
"""

from ctypes import Array, LittleEndianStructure, c_char, c_double, c_float, c_uint8, c_uint32, c_uint64, sizeof
from enum import IntEnum
from math import nan

PIXELS_MAX = 1 << 20
CHANNELS_MAX = 8
SAMPLES_MAX = 256
CLASSES_MAX = 16
SERVICES_MAX = 32
LABEL_BYTES = 24

Label = c_char * LABEL_BYTES


class Status(IntEnum):
    """What a sample says of itself. A number that is not listed here marks a sample as bad."""

    OK = 0
    WARMING_UP = 1
    UNCERTAIN = 2
    NOT_VISIBLE = 3
    BAD_GEOMETRY = 4
    NOT_OBSERVABLE = 5
    LACK_OF_FIT = 6
    INPUT_REJECTED = 7
    BAD_SAMPLE = 8
    NO_DATA = 9
    INCOMPLETE = 10
    STANDING_STILL = 11
    UNKNOWN_TERRAIN = 12
    SENSOR_FAULT = 13
    ENDED = 14


class Reason(IntEnum):
    """Why a soil's row was left out: `Soil.reason`."""

    USED = 0
    NO_SINKAGE = 1
    NO_WHEEL = 2
    STOPPED = 3
    HARD_GROUND = 4
    SLIP = 5
    LOAD = 6
    OUTLIER = 7
    STUCK_ANGLE = 8


class Part(IntEnum):
    """The bits of `Terrain.valid`."""

    SINKAGE = 1
    SOIL = 2
    STRENGTH = 4
    CLASS = 8


class ServiceState(IntEnum):
    """What a service is doing: `Supervision.state`."""

    STARTING = 0
    RUNNING = 1
    BACKOFF = 2
    GIVEN_UP = 3
    STOPPED = 4


class Header(LittleEndianStructure):
    """The first 32 bytes of every sample."""

    _fields_ = [
        ("taken_ns", c_uint64),
        ("published_ns", c_uint64),
        ("sequence", c_uint64),
        ("generation", c_uint32),
        ("status", c_uint32),
    ]

    def answer(self, status):
        """The header of the answer to a triggering input: its instant and its number, with the answer's own status."""
        return Header(taken_ns=self.taken_ns, sequence=self.sequence, status=status)


class Message(LittleEndianStructure):
    """What a type must be to travel on a wire. `NAME` is its name and version."""

    @classmethod
    def empty(cls, header):
        """A sample that knows nothing: `header`, NaN in every field of 8 bytes that holds one number, else zero."""
        return cls(header=header, **{name: nan for name, kind in cls._fields_ if kind is c_double})

    @classmethod
    def type_name(cls):
        """The name under which iceoryx2 knows the type."""
        return f"terrasense/{cls.NAME}"

    @classmethod
    def fingerprint(cls):
        """The layout as text. Two processes exchange samples only where their texts are equal."""
        return layout(cls, cls.NAME)


class Frame(Message):
    """One 8-bit gray picture with the wheel's pose in it."""

    NAME = "Frame/1"
    _fields_ = [
        ("header", Header),
        ("width", c_uint32),
        ("height", c_uint32),
        ("crop_x_px", c_uint32),
        ("crop_y_px", c_uint32),
        ("center_x_px", c_double),
        ("center_y_px", c_double),
        ("rim_radius_px", c_double),
        ("wheel_radius_px", c_double),
        ("pitch_rad", c_double),
        ("homography", c_double * 9),
        ("pixels", c_uint8 * PIXELS_MAX),
    ]


class Wheel(Message):
    """One reading of a wheel's telemetry."""

    NAME = "Wheel/1"
    _fields_ = [
        ("header", Header),
        ("load_n", c_double),
        ("torque_nm", c_double),
        ("angular_velocity_rad_s", c_double),
        ("linear_velocity_m_s", c_double),
        ("slip", c_double),
    ]


class Vibration(Message):
    """A piece of vibration."""

    NAME = "Vibration/1"
    _fields_ = [
        ("header", Header),
        ("start_ns", c_uint64),
        ("period_ns", c_uint64),
        ("count", c_uint32),
        ("channel_count", c_uint32),
        ("channels", Label * CHANNELS_MAX),
        ("offset_ns", c_uint32 * SAMPLES_MAX),
        ("samples", (c_float * SAMPLES_MAX) * CHANNELS_MAX),
    ]


class Sinkage(Message):
    """The soil line at one wheel."""

    NAME = "Sinkage/1"
    _fields_ = [
        ("header", Header),
        ("left_rad", c_double),
        ("left_sigma_rad", c_double),
        ("right_rad", c_double),
        ("right_sigma_rad", c_double),
        ("entry_rad", c_double),
        ("entry_sigma_rad", c_double),
        ("exit_rad", c_double),
        ("exit_sigma_rad", c_double),
        ("sinkage_m", c_double),
        ("sinkage_sigma_m", c_double),
        ("confidence", c_double),
        ("center_x_px", c_double),
        ("center_y_px", c_double),
    ]


class Soil(Message):
    """The soil's estimated parameters after one cycle."""

    NAME = "Soil/1"
    _fields_ = [
        ("header", Header),
        ("cohesion_pa", c_double),
        ("cohesion_sigma_pa", c_double),
        ("friction_rad", c_double),
        ("friction_sigma_rad", c_double),
        ("cohesion_friction_covariance_pa_rad", c_double),
        ("strength_pa", c_double),
        ("strength_sigma_pa", c_double),
        ("pressure_pa", c_double),
        ("shear_modulus_m", c_double),
        ("shear_modulus_sigma_m", c_double),
        ("sinkage_exponent", c_double),
        ("sinkage_exponent_sigma", c_double),
        ("slip", c_double),
        ("normalized_innovation", c_double),
        ("rows", c_uint32),
        ("resets", c_uint32),
        ("rows_rejected", c_uint32),
        ("reason", c_uint32),
    ]


class TerrainClass(Message):
    """The class of the terrain, after one piece of vibration."""

    NAME = "TerrainClass/1"
    _fields_ = [
        ("header", Header),
        ("start_ns", c_uint64),
        ("window_ns", c_uint64),
        ("class", c_uint32),
        ("class_count", c_uint32),
        ("unknown", c_uint32),
        ("windows", c_uint32),
        ("metric", c_double),
        ("probability", c_double * CLASSES_MAX),
        ("labels", Label * CLASSES_MAX),
    ]


class Terrain(Message):
    """Everything of one cycle in one sample."""

    NAME = "Terrain/1"
    NEVER_NS = (1 << 64) - 1
    _fields_ = [
        ("header", Header),
        ("sinkage_m", c_double),
        ("sinkage_sigma_m", c_double),
        ("entry_rad", c_double),
        ("entry_sigma_rad", c_double),
        ("cohesion_pa", c_double),
        ("cohesion_sigma_pa", c_double),
        ("friction_rad", c_double),
        ("friction_sigma_rad", c_double),
        ("cohesion_friction_covariance_pa_rad", c_double),
        ("strength_pa", c_double),
        ("strength_sigma_pa", c_double),
        ("pressure_pa", c_double),
        ("slip", c_double),
        ("class_probability", c_double),
        ("class_metric", c_double),
        ("sinkage_age_ns", c_uint64),
        ("soil_age_ns", c_uint64),
        ("class_age_ns", c_uint64),
        ("sinkage_status", c_uint32),
        ("soil_status", c_uint32),
        ("class_status", c_uint32),
        ("valid", c_uint32),
        ("class", c_uint32),
        ("unknown", c_uint32),
        ("class_label", Label),
    ]


class Supervision(Message):
    """The launcher's table of services."""

    NAME = "Supervision/1"
    _fields_ = [
        ("header", Header),
        ("launcher_pid", c_uint32),
        ("service_count", c_uint32),
        ("name", Label * SERVICES_MAX),
        ("pid", c_uint32 * SERVICES_MAX),
        ("state", c_uint32 * SERVICES_MAX),
        ("generation", c_uint32 * SERVICES_MAX),
        ("restarts", c_uint32 * SERVICES_MAX),
        ("published", c_uint64 * SERVICES_MAX),
        ("lost", c_uint64 * SERVICES_MAX),
        ("bad", c_uint64 * SERVICES_MAX),
        ("missed", c_uint64 * SERVICES_MAX),
        ("rate_hz", c_double * SERVICES_MAX),
        ("latency_p50_ns", c_uint64 * SERVICES_MAX),
        ("latency_p99_ns", c_uint64 * SERVICES_MAX),
    ]


MESSAGES = (Frame, Wheel, Vibration, Sinkage, Soil, TerrainClass, Terrain, Supervision)


def layout(structure, name):
    """Name, size, and a word a field: `Wheel/1 72 header:header@0 load_n:f64@32 …`."""
    words = [name, str(sizeof(structure))]
    for field, kind in structure._fields_:
        element, count = _element(field, kind)
        words.append(f"{field}:{element}{f'x{count}' if count > 1 else ''}@{getattr(structure, field).offset}")
    return " ".join(words)


_ELEMENTS = {Header: "header", c_uint8: "u8", c_uint32: "u32", c_uint64: "u64", c_float: "f32", c_double: "f64"}


def _element(field, kind):
    """The name of a field's elements and their number; a text counts as one element."""
    if kind is c_uint32 and (field == "status" or field.endswith("_status")):
        return "status", 1
    count = 1
    while issubclass(kind, Array):
        if kind._type_ is c_char:
            return f"text{kind._length_}", count
        count *= kind._length_
        kind = kind._type_
    return _ELEMENTS[kind], count
