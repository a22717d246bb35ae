#include "tests/support/robot_sim/patrol.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "services/base/clock.h"

namespace rips::robot_sim {
namespace {

// How far a command reaches: at a lower speed it stops at the middle of the next cell.
constexpr double kReachS = 0.1;
// Closer to the middle of the goal's cell than this it is there, metres.
constexpr double kThere = 0.005;
// A base that was not asked for longer stood still meanwhile.
constexpr int64_t kPauseNs = kNanosPerSecond;

}  // namespace

Patrol::Patrol(Floor floor) : floor_(std::move(floor)) {
  const auto& places = floor_.plan().places;
  if (!places.empty()) at_ = floor_.MiddleOf(places.begin()->second);
}

absl::Status Patrol::Send(const std::string& place) {
  const auto it = floor_.plan().places.find(place);
  if (it == floor_.plan().places.end()) {
    return absl::NotFoundError(absl::StrCat("the floor has no place `", place, "`"));
  }
  goal_ = it->second;
  return absl::OkStatus();
}

InTheWay Patrol::Now(int64_t now_ns, bool keep_out) const {
  InTheWay out{.keep_out = keep_out};
  if (person_since_ns_) out.person = floor_.PersonAfter(now_ns - *person_since_ns_);
  return out;
}

Twist Patrol::Steer(int64_t now_ns, bool keep_out, double max_speed) const {
  if (!goal_) return {};
  const Cell here = floor_.CellOf(at_);
  const std::vector<Cell> way = floor_.Way(here, *goal_, Now(now_ns, keep_out));
  if (way.empty() && !(here == *goal_)) return {};
  const Floor::Point next = floor_.MiddleOf(way.empty() ? *goal_ : way.front());
  const double dx = next.x - at_.x;
  const double dy = next.y - at_.y;
  const double left = std::hypot(dx, dy);
  if (way.size() < 2 && left < kThere) return {};
  const double speed = way.size() < 2 ? std::min(max_speed, left / kReachS) : max_speed;
  return {.linear_x = speed * dx / left, .linear_y = speed * dy / left};
}

void Patrol::Drive(int64_t now_ns, const Twist& speed) {
  const int64_t since_ns = std::exchange(driven_ns_, now_ns);
  if (since_ns == 0 || now_ns - since_ns > kPauseNs) return;
  const double seconds = static_cast<double>(now_ns - since_ns) / kNanosPerSecond;
  at_.x += speed.linear_x * seconds;
  at_.y += speed.linear_y * seconds;
}

std::string Patrol::Grid(int64_t now_ns, bool keep_out) const {
  return floor_.Grid(Now(now_ns, keep_out));
}

}  // namespace rips::robot_sim
