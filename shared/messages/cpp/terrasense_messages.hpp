/// Every sample that crosses a process boundary, for services written in C++17. Standard library only.
///
/// The fields, their units and their meaning are described in `shared/messages/src`; `tests/layout.rs` compares the two,
/// offset by offset. Field names are those of Rust, but for `class_`, since `class` is a word of C++.

#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <type_traits>

namespace terrasense {

inline constexpr std::size_t PIXELS_MAX = 1 << 20;
inline constexpr std::size_t CHANNELS_MAX = 8;
inline constexpr std::size_t SAMPLES_MAX = 256;
inline constexpr std::size_t CLASSES_MAX = 16;
inline constexpr std::size_t SERVICES_MAX = 32;
inline constexpr std::size_t LABEL_BYTES = 24;

/// A short name in UTF-8, filled up with zeros.
struct Label {
    char bytes[LABEL_BYTES];
};

/// One field of a message: `size` is that of one element, `count` the number of elements of all dimensions together.
struct Field {
    const char* name;
    const char* element;
    std::size_t offset;
    std::size_t size;
    std::size_t count;
};

/// The fields of a message, in order.
template <class Message>
inline constexpr std::nullptr_t fields = nullptr;

/// The name of an element's type in a fingerprint.
template <class Element>
inline constexpr const char* element_name = nullptr;

/// True if the fields follow each other without a gap up to the message's end.
template <class Message>
constexpr bool covers() {
    std::size_t end = 0;
    for (const Field& field : fields<Message>) {
        if (field.offset != end) {
            return false;
        }
        end += field.size * field.count;
    }
    return end == sizeof(Message) && std::is_standard_layout_v<Message> && std::is_trivially_copyable_v<Message>;
}

/// The layout as text. Two processes exchange samples only where their texts are equal.
template <class Message>
std::string fingerprint() {
    const std::string type_name = Message::IOX2_TYPE_NAME;
    std::string text = type_name.substr(type_name.find('/') + 1) + ' ' + std::to_string(sizeof(Message));
    for (const Field& field : fields<Message>) {
        text += std::string(" ") + field.name + ':' + field.element;
        if (field.count > 1) {
            text += 'x' + std::to_string(field.count);
        }
        text += '@' + std::to_string(field.offset);
    }
    return text;
}

// A member's name as text and its offset can only be had together from the preprocessor.
#define TERRASENSE_FIELD_NAMED(Message, text, member)                                                                  \
    Field {                                                                                                            \
        text, element_name<std::remove_all_extents_t<decltype(Message::member)>>, offsetof(Message, member),           \
            sizeof(std::remove_all_extents_t<decltype(Message::member)>),                                              \
            sizeof(Message::member) / sizeof(std::remove_all_extents_t<decltype(Message::member)>)                     \
    }
#define TERRASENSE_FIELD(Message, member) TERRASENSE_FIELD_NAMED(Message, #member, member)

/// What a sample says of itself. An open enum: a number that is not listed here marks a sample as bad.
enum class Status : std::uint32_t {
    OK = 0,
    WARMING_UP = 1,
    UNCERTAIN = 2,
    NOT_VISIBLE = 3,
    BAD_GEOMETRY = 4,
    NOT_OBSERVABLE = 5,
    LACK_OF_FIT = 6,
    INPUT_REJECTED = 7,
    BAD_SAMPLE = 8,
    NO_DATA = 9,
    INCOMPLETE = 10,
    STANDING_STILL = 11,
    UNKNOWN_TERRAIN = 12,
    SENSOR_FAULT = 13,
    ENDED = 14,
};

/// Why a soil's row was left out: `Soil::reason`.
enum class Reason : std::uint32_t {
    USED = 0,
    NO_SINKAGE = 1,
    NO_WHEEL = 2,
    STOPPED = 3,
    HARD_GROUND = 4,
    SLIP = 5,
    LOAD = 6,
    OUTLIER = 7,
    STUCK_ANGLE = 8,
};

/// The bits of `Terrain::valid`.
enum class Part : std::uint32_t {
    SINKAGE = 1,
    SOIL = 2,
    STRENGTH = 4,
    CLASS = 8,
};

/// What a service is doing: `Supervision::state`.
enum class ServiceState : std::uint32_t {
    STARTING = 0,
    RUNNING = 1,
    BACKOFF = 2,
    GIVEN_UP = 3,
    STOPPED = 4,
};

struct Header;

template <>
inline constexpr const char* element_name<Header> = "header";
template <>
inline constexpr const char* element_name<Status> = "status";
template <>
inline constexpr const char* element_name<Label> = "text24";
template <>
inline constexpr const char* element_name<std::uint8_t> = "u8";
template <>
inline constexpr const char* element_name<std::uint32_t> = "u32";
template <>
inline constexpr const char* element_name<std::uint64_t> = "u64";
template <>
inline constexpr const char* element_name<float> = "f32";
template <>
inline constexpr const char* element_name<double> = "f64";

/// The first 32 bytes of every sample.
struct Header {
    static constexpr const char* IOX2_TYPE_NAME = "terrasense/Header/1";

    std::uint64_t taken_ns;
    std::uint64_t published_ns;
    std::uint64_t sequence;
    std::uint32_t generation;
    Status status;
};

static_assert(sizeof(Header) == 32);
template <>
inline constexpr Field fields<Header>[] = {
    TERRASENSE_FIELD(Header, taken_ns),
    TERRASENSE_FIELD(Header, published_ns),
    TERRASENSE_FIELD(Header, sequence),
    TERRASENSE_FIELD(Header, generation),
    TERRASENSE_FIELD(Header, status),
};
static_assert(covers<Header>());

/// The header of the answer to a triggering input: its instant and its number, with the answer's own status.
inline Header answer(const Header& trigger, Status status) {
    return Header{trigger.taken_ns, 0, trigger.sequence, 0, status};
}

/// One 8-bit gray picture with the wheel's pose in it.
struct Frame {
    static constexpr const char* IOX2_TYPE_NAME = "terrasense/Frame/1";

    Header header;
    std::uint32_t width;
    std::uint32_t height;
    std::uint32_t crop_x_px;
    std::uint32_t crop_y_px;
    double center_x_px;
    double center_y_px;
    double rim_radius_px;
    double wheel_radius_px;
    double pitch_rad;
    double homography[9];
    std::uint8_t pixels[PIXELS_MAX];
};

static_assert(sizeof(Frame) == 1048736);
template <>
inline constexpr Field fields<Frame>[] = {
    TERRASENSE_FIELD(Frame, header),
    TERRASENSE_FIELD(Frame, width),
    TERRASENSE_FIELD(Frame, height),
    TERRASENSE_FIELD(Frame, crop_x_px),
    TERRASENSE_FIELD(Frame, crop_y_px),
    TERRASENSE_FIELD(Frame, center_x_px),
    TERRASENSE_FIELD(Frame, center_y_px),
    TERRASENSE_FIELD(Frame, rim_radius_px),
    TERRASENSE_FIELD(Frame, wheel_radius_px),
    TERRASENSE_FIELD(Frame, pitch_rad),
    TERRASENSE_FIELD(Frame, homography),
    TERRASENSE_FIELD(Frame, pixels),
};
static_assert(covers<Frame>());

/// One reading of a wheel's telemetry.
struct Wheel {
    static constexpr const char* IOX2_TYPE_NAME = "terrasense/Wheel/1";

    Header header;
    double load_n;
    double torque_nm;
    double angular_velocity_rad_s;
    double linear_velocity_m_s;
    double slip;
};

static_assert(sizeof(Wheel) == 72);
template <>
inline constexpr Field fields<Wheel>[] = {
    TERRASENSE_FIELD(Wheel, header),
    TERRASENSE_FIELD(Wheel, load_n),
    TERRASENSE_FIELD(Wheel, torque_nm),
    TERRASENSE_FIELD(Wheel, angular_velocity_rad_s),
    TERRASENSE_FIELD(Wheel, linear_velocity_m_s),
    TERRASENSE_FIELD(Wheel, slip),
};
static_assert(covers<Wheel>());

/// A piece of vibration.
struct Vibration {
    static constexpr const char* IOX2_TYPE_NAME = "terrasense/Vibration/1";

    Header header;
    std::uint64_t start_ns;
    std::uint64_t period_ns;
    std::uint32_t count;
    std::uint32_t channel_count;
    Label channels[CHANNELS_MAX];
    std::uint32_t offset_ns[SAMPLES_MAX];
    float samples[CHANNELS_MAX][SAMPLES_MAX];
};

static_assert(sizeof(Vibration) == 9464);
template <>
inline constexpr Field fields<Vibration>[] = {
    TERRASENSE_FIELD(Vibration, header),
    TERRASENSE_FIELD(Vibration, start_ns),
    TERRASENSE_FIELD(Vibration, period_ns),
    TERRASENSE_FIELD(Vibration, count),
    TERRASENSE_FIELD(Vibration, channel_count),
    TERRASENSE_FIELD(Vibration, channels),
    TERRASENSE_FIELD(Vibration, offset_ns),
    TERRASENSE_FIELD(Vibration, samples),
};
static_assert(covers<Vibration>());

/// The soil line at one wheel.
struct Sinkage {
    static constexpr const char* IOX2_TYPE_NAME = "terrasense/Sinkage/1";

    Header header;
    double left_rad;
    double left_sigma_rad;
    double right_rad;
    double right_sigma_rad;
    double entry_rad;
    double entry_sigma_rad;
    double exit_rad;
    double exit_sigma_rad;
    double sinkage_m;
    double sinkage_sigma_m;
    double confidence;
    double center_x_px;
    double center_y_px;
};

static_assert(sizeof(Sinkage) == 136);
template <>
inline constexpr Field fields<Sinkage>[] = {
    TERRASENSE_FIELD(Sinkage, header),
    TERRASENSE_FIELD(Sinkage, left_rad),
    TERRASENSE_FIELD(Sinkage, left_sigma_rad),
    TERRASENSE_FIELD(Sinkage, right_rad),
    TERRASENSE_FIELD(Sinkage, right_sigma_rad),
    TERRASENSE_FIELD(Sinkage, entry_rad),
    TERRASENSE_FIELD(Sinkage, entry_sigma_rad),
    TERRASENSE_FIELD(Sinkage, exit_rad),
    TERRASENSE_FIELD(Sinkage, exit_sigma_rad),
    TERRASENSE_FIELD(Sinkage, sinkage_m),
    TERRASENSE_FIELD(Sinkage, sinkage_sigma_m),
    TERRASENSE_FIELD(Sinkage, confidence),
    TERRASENSE_FIELD(Sinkage, center_x_px),
    TERRASENSE_FIELD(Sinkage, center_y_px),
};
static_assert(covers<Sinkage>());

/// The soil's estimated parameters after one cycle.
struct Soil {
    static constexpr const char* IOX2_TYPE_NAME = "terrasense/Soil/1";

    Header header;
    double cohesion_pa;
    double cohesion_sigma_pa;
    double friction_rad;
    double friction_sigma_rad;
    double cohesion_friction_covariance_pa_rad;
    double strength_pa;
    double strength_sigma_pa;
    double pressure_pa;
    double shear_modulus_m;
    double shear_modulus_sigma_m;
    double sinkage_exponent;
    double sinkage_exponent_sigma;
    double slip;
    double normalized_innovation;
    std::uint32_t rows;
    std::uint32_t resets;
    std::uint32_t rows_rejected;
    std::uint32_t reason;
};

static_assert(sizeof(Soil) == 160);
template <>
inline constexpr Field fields<Soil>[] = {
    TERRASENSE_FIELD(Soil, header),
    TERRASENSE_FIELD(Soil, cohesion_pa),
    TERRASENSE_FIELD(Soil, cohesion_sigma_pa),
    TERRASENSE_FIELD(Soil, friction_rad),
    TERRASENSE_FIELD(Soil, friction_sigma_rad),
    TERRASENSE_FIELD(Soil, cohesion_friction_covariance_pa_rad),
    TERRASENSE_FIELD(Soil, strength_pa),
    TERRASENSE_FIELD(Soil, strength_sigma_pa),
    TERRASENSE_FIELD(Soil, pressure_pa),
    TERRASENSE_FIELD(Soil, shear_modulus_m),
    TERRASENSE_FIELD(Soil, shear_modulus_sigma_m),
    TERRASENSE_FIELD(Soil, sinkage_exponent),
    TERRASENSE_FIELD(Soil, sinkage_exponent_sigma),
    TERRASENSE_FIELD(Soil, slip),
    TERRASENSE_FIELD(Soil, normalized_innovation),
    TERRASENSE_FIELD(Soil, rows),
    TERRASENSE_FIELD(Soil, resets),
    TERRASENSE_FIELD(Soil, rows_rejected),
    TERRASENSE_FIELD(Soil, reason),
};
static_assert(covers<Soil>());

/// The class of the terrain, after one piece of vibration.
struct TerrainClass {
    static constexpr const char* IOX2_TYPE_NAME = "terrasense/TerrainClass/1";

    Header header;
    std::uint64_t start_ns;
    std::uint64_t window_ns;
    std::uint32_t class_;
    std::uint32_t class_count;
    std::uint32_t unknown;
    std::uint32_t windows;
    double metric;
    double probability[CLASSES_MAX];
    Label labels[CLASSES_MAX];
};

static_assert(sizeof(TerrainClass) == 584);
template <>
inline constexpr Field fields<TerrainClass>[] = {
    TERRASENSE_FIELD(TerrainClass, header),
    TERRASENSE_FIELD(TerrainClass, start_ns),
    TERRASENSE_FIELD(TerrainClass, window_ns),
    TERRASENSE_FIELD_NAMED(TerrainClass, "class", class_),
    TERRASENSE_FIELD(TerrainClass, class_count),
    TERRASENSE_FIELD(TerrainClass, unknown),
    TERRASENSE_FIELD(TerrainClass, windows),
    TERRASENSE_FIELD(TerrainClass, metric),
    TERRASENSE_FIELD(TerrainClass, probability),
    TERRASENSE_FIELD(TerrainClass, labels),
};
static_assert(covers<TerrainClass>());

/// Everything of one cycle in one sample.
struct Terrain {
    static constexpr const char* IOX2_TYPE_NAME = "terrasense/Terrain/1";
    /// The age of a part that has never been there.
    static constexpr std::uint64_t NEVER_NS = UINT64_MAX;

    Header header;
    double sinkage_m;
    double sinkage_sigma_m;
    double entry_rad;
    double entry_sigma_rad;
    double cohesion_pa;
    double cohesion_sigma_pa;
    double friction_rad;
    double friction_sigma_rad;
    double cohesion_friction_covariance_pa_rad;
    double strength_pa;
    double strength_sigma_pa;
    double pressure_pa;
    double slip;
    double class_probability;
    double class_metric;
    std::uint64_t sinkage_age_ns;
    std::uint64_t soil_age_ns;
    std::uint64_t class_age_ns;
    Status sinkage_status;
    Status soil_status;
    Status class_status;
    std::uint32_t valid;
    std::uint32_t class_;
    std::uint32_t unknown;
    Label class_label;
};

static_assert(sizeof(Terrain) == 224);
template <>
inline constexpr Field fields<Terrain>[] = {
    TERRASENSE_FIELD(Terrain, header),
    TERRASENSE_FIELD(Terrain, sinkage_m),
    TERRASENSE_FIELD(Terrain, sinkage_sigma_m),
    TERRASENSE_FIELD(Terrain, entry_rad),
    TERRASENSE_FIELD(Terrain, entry_sigma_rad),
    TERRASENSE_FIELD(Terrain, cohesion_pa),
    TERRASENSE_FIELD(Terrain, cohesion_sigma_pa),
    TERRASENSE_FIELD(Terrain, friction_rad),
    TERRASENSE_FIELD(Terrain, friction_sigma_rad),
    TERRASENSE_FIELD(Terrain, cohesion_friction_covariance_pa_rad),
    TERRASENSE_FIELD(Terrain, strength_pa),
    TERRASENSE_FIELD(Terrain, strength_sigma_pa),
    TERRASENSE_FIELD(Terrain, pressure_pa),
    TERRASENSE_FIELD(Terrain, slip),
    TERRASENSE_FIELD(Terrain, class_probability),
    TERRASENSE_FIELD(Terrain, class_metric),
    TERRASENSE_FIELD(Terrain, sinkage_age_ns),
    TERRASENSE_FIELD(Terrain, soil_age_ns),
    TERRASENSE_FIELD(Terrain, class_age_ns),
    TERRASENSE_FIELD(Terrain, sinkage_status),
    TERRASENSE_FIELD(Terrain, soil_status),
    TERRASENSE_FIELD(Terrain, class_status),
    TERRASENSE_FIELD(Terrain, valid),
    TERRASENSE_FIELD_NAMED(Terrain, "class", class_),
    TERRASENSE_FIELD(Terrain, unknown),
    TERRASENSE_FIELD(Terrain, class_label),
};
static_assert(covers<Terrain>());

/// The launcher's table of services.
struct Supervision {
    static constexpr const char* IOX2_TYPE_NAME = "terrasense/Supervision/1";

    Header header;
    std::uint32_t launcher_pid;
    std::uint32_t service_count;
    Label name[SERVICES_MAX];
    std::uint32_t pid[SERVICES_MAX];
    std::uint32_t state[SERVICES_MAX];
    std::uint32_t generation[SERVICES_MAX];
    std::uint32_t restarts[SERVICES_MAX];
    std::uint64_t published[SERVICES_MAX];
    std::uint64_t lost[SERVICES_MAX];
    std::uint64_t bad[SERVICES_MAX];
    std::uint64_t missed[SERVICES_MAX];
    double rate_hz[SERVICES_MAX];
    std::uint64_t latency_p50_ns[SERVICES_MAX];
    std::uint64_t latency_p99_ns[SERVICES_MAX];
};

static_assert(sizeof(Supervision) == 3112);
template <>
inline constexpr Field fields<Supervision>[] = {
    TERRASENSE_FIELD(Supervision, header),
    TERRASENSE_FIELD(Supervision, launcher_pid),
    TERRASENSE_FIELD(Supervision, service_count),
    TERRASENSE_FIELD(Supervision, name),
    TERRASENSE_FIELD(Supervision, pid),
    TERRASENSE_FIELD(Supervision, state),
    TERRASENSE_FIELD(Supervision, generation),
    TERRASENSE_FIELD(Supervision, restarts),
    TERRASENSE_FIELD(Supervision, published),
    TERRASENSE_FIELD(Supervision, lost),
    TERRASENSE_FIELD(Supervision, bad),
    TERRASENSE_FIELD(Supervision, missed),
    TERRASENSE_FIELD(Supervision, rate_hz),
    TERRASENSE_FIELD(Supervision, latency_p50_ns),
    TERRASENSE_FIELD(Supervision, latency_p99_ns),
};
static_assert(covers<Supervision>());

#undef TERRASENSE_FIELD
#undef TERRASENSE_FIELD_NAMED

}  // namespace terrasense
