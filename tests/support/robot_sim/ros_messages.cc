#include "tests/support/robot_sim/ros_messages.h"

#include <array>
#include <bit>
#include <cstddef>
#include <utility>
#include <variant>

#include "services/base/clock.h"
#include "services/ros2/cdr.h"
#include "services/ros2/parameter_messages.h"

namespace rips::robot_sim {
namespace {

using ros2::CdrReader;
using ros2::CdrWriter;

constexpr uint32_t kBytesPerPixel = 3;
constexpr uint32_t kRays = 360;
constexpr double kPi = 3.14159265358979;
constexpr uint8_t kLogInfo = 20;
constexpr size_t kCovariance = 36;

void F32(CdrWriter& out, double value) {
  out.U32(std::bit_cast<uint32_t>(static_cast<float>(value)));
}

void Stamp(CdrWriter& out, int64_t unix_ns) {
  out.U32(static_cast<uint32_t>(unix_ns / kNanosPerSecond));
  out.U32(static_cast<uint32_t>(unix_ns % kNanosPerSecond));
}

void Header(CdrWriter& out, int64_t unix_ns, absl::string_view frame) {
  Stamp(out, unix_ns);
  out.String(frame);
}

void Zeros(CdrWriter& out, size_t count) {
  for (size_t i = 0; i < count; ++i) {
    out.F64(0);
  }
}

void SkipHeader(CdrReader& in) {
  in.U32();
  in.U32();
  in.String();
}

void Skip(CdrReader& in, size_t doubles) {
  for (size_t i = 0; i < doubles; ++i) in.F64();
}

// rcl_interfaces/msg/ParameterValue: every alternative is on the wire, `type` says which counts.
// A System Modes file has no arrays.
void Value(CdrWriter& out, const ros2::ParameterValue& value) {
  constexpr size_t kArrays = 5;
  out.U8(static_cast<uint8_t>(value.index()));
  const bool* truth = std::get_if<bool>(&value);
  const int64_t* integer = std::get_if<int64_t>(&value);
  const double* real = std::get_if<double>(&value);
  const std::string* text = std::get_if<std::string>(&value);
  out.Bool(truth != nullptr && *truth);
  out.I64(integer == nullptr ? 0 : *integer);
  out.F64(real == nullptr ? 0 : *real);
  out.String(text == nullptr ? "" : *text);
  for (size_t i = 0; i < kArrays; ++i) {
    out.U32(0);
  }
}

void Parameters(CdrWriter& out, const actuator::ParameterMap& parameters) {
  out.U32(static_cast<uint32_t>(parameters.size()));
  for (const auto& [name, value] : parameters) {
    out.String(name);
    Value(out, value);
  }
}

void State(CdrWriter& out, const ros2::LifecycleLabel& state) {
  out.U8(state.id);
  out.String(state.label);
}

}  // namespace

std::string EncodeImage(int64_t unix_ns, uint32_t frame, ImageSize size, bool covered) {
  CdrWriter out;
  Header(out, unix_ns, "camera_link");
  out.U32(size.height);
  out.U32(size.width);
  out.String("rgb8");
  out.U8(0);
  out.U32(size.width * kBytesPerPixel);
  std::string pixels(size_t{size.width} * size.height * kBytesPerPixel, '\0');
  for (size_t i = 0; i < pixels.size() && !covered; ++i) {
    pixels[i] = static_cast<char>((i + frame) & 0xff);
  }
  out.U32(static_cast<uint32_t>(pixels.size()));
  out.Octets(pixels);
  return std::move(out).Finish();
}

std::string EncodeLaserScan(int64_t unix_ns, double distance) {
  CdrWriter out;
  Header(out, unix_ns, "laser_link");
  F32(out, -kPi);             // angle_min
  F32(out, kPi);              // angle_max
  F32(out, 2 * kPi / kRays);  // angle_increment
  F32(out, 0);                // time_increment
  F32(out, 0.1);              // scan_time
  F32(out, 0.1);              // range_min
  F32(out, 10);               // range_max
  out.U32(kRays);
  for (uint32_t i = 0; i < kRays; ++i) {
    F32(out, distance);
  }
  out.U32(0);  // intensities
  return std::move(out).Finish();
}

std::string EncodeOdometry(int64_t unix_ns, const Odometry& odometry) {
  CdrWriter out;
  Header(out, unix_ns, "odom");
  out.String("base_link");
  out.F64(odometry.x);
  out.F64(odometry.y);
  Zeros(out, 4);  // z, and x, y, z of the orientation
  out.F64(1);     // w
  Zeros(out, kCovariance);
  out.F64(odometry.speed_x);
  out.F64(odometry.speed_y);
  Zeros(out, 4);  // the rest of the twist
  Zeros(out, kCovariance);
  return std::move(out).Finish();
}

absl::StatusOr<Odometry> DecodeOdometry(absl::string_view payload) {
  CdrReader in(payload);
  SkipHeader(in);
  in.String();
  Odometry out;
  out.x = in.F64();
  out.y = in.F64();
  Skip(in, 5 + kCovariance);
  out.speed_x = in.F64();
  out.speed_y = in.F64();
  Skip(in, 4 + kCovariance);
  if (absl::Status status = in.Finish(); !status.ok()) return status;
  return out;
}

std::string EncodeOccupancyGrid(int64_t unix_ns, uint32_t width, uint32_t height, double cell_m,
                                absl::string_view cells) {
  CdrWriter out;
  Header(out, unix_ns, "map");
  Stamp(out, 0);  // when the map was loaded
  F32(out, cell_m);
  out.U32(width);
  out.U32(height);
  Zeros(out, 6);  // of the origin: x, y, z, and x, y, z of the orientation
  out.F64(1);     // w
  out.U32(static_cast<uint32_t>(cells.size()));
  out.Octets(cells);
  return std::move(out).Finish();
}

absl::StatusOr<CellCount> CountOccupancyGrid(absl::string_view payload) {
  CdrReader in(payload);
  SkipHeader(in);
  in.U32();
  in.U32();
  in.U32();  // metres of a cell
  const uint64_t width = in.U32();
  const uint64_t height = in.U32();
  Skip(in, 7);
  const uint32_t size = in.Count(1, payload.size());
  if (size != width * height) in.Fail("the grid has not width x height cells");
  CellCount count;
  for (const char cell : in.Octets(in.ok() ? size : 0)) {
    if (cell == 0) ++count.free;
    if (cell == 100) ++count.occupied;
  }
  if (count.free + count.occupied != size) in.Fail("a cell is neither free nor occupied");
  if (absl::Status status = in.Finish(); !status.ok()) return status;
  return count;
}

std::string EncodeTwist(const Twist& twist) {
  CdrWriter out;
  out.F64(twist.linear_x);
  out.F64(twist.linear_y);
  Zeros(out, 3);
  out.F64(twist.angular_z);
  return std::move(out).Finish();
}

absl::StatusOr<Twist> DecodeTwist(absl::string_view payload) {
  CdrReader in(payload);
  std::array<double, 6> members{};
  for (double& member : members) {
    member = in.F64();
  }
  if (absl::Status status = in.Finish(); !status.ok()) {
    return status;
  }
  return Twist{.linear_x = members[0], .linear_y = members[1], .angular_z = members[5]};
}

std::string EncodeLog(int64_t unix_ns, absl::string_view node, absl::string_view text) {
  CdrWriter out;
  Stamp(out, unix_ns);
  out.U8(kLogInfo);
  out.String(node);
  out.String(text);
  out.String("");  // file
  out.String("");  // function
  out.U32(0);      // line
  return std::move(out).Finish();
}

std::string EncodeParameterEvent(int64_t unix_ns, absl::string_view node,
                                 const actuator::ParameterMap& added,
                                 const actuator::ParameterMap& changed) {
  CdrWriter out;
  Stamp(out, unix_ns);
  out.String(node);
  Parameters(out, added);
  Parameters(out, changed);
  out.U32(0);  // deleted
  return std::move(out).Finish();
}

std::string EncodeTransitionEvent(const ros2::LifecycleLabel& start,
                                  const ros2::LifecycleLabel& goal) {
  CdrWriter out;
  out.U64(0);
  State(out, {});
  State(out, start);
  State(out, goal);
  return std::move(out).Finish();
}

std::string EncodeModeEvent(absl::string_view start, absl::string_view goal) {
  CdrWriter out;
  out.U64(0);
  out.String(start);
  out.String(goal);
  return std::move(out).Finish();
}

std::string EncodeListParametersReply(const std::vector<std::string>& names) {
  CdrWriter out;
  out.U32(static_cast<uint32_t>(names.size()));
  for (const std::string& name : names) {
    out.String(name);
  }
  out.U32(0);  // prefixes
  return std::move(out).Finish();
}

}  // namespace rips::robot_sim
