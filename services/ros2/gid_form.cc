#include "services/ros2/gid_form.h"

#include <algorithm>

namespace rips::ros2 {
namespace {

constexpr size_t kEncapsulationBytes = 4;
constexpr size_t kCountBytes = 4;

}  // namespace

std::optional<GidBytes> GidFormOf(absl::string_view payload) {
  constexpr size_t kShortest16 = kEncapsulationBytes + 16 + kCountBytes;
  constexpr size_t kShortest24 = kEncapsulationBytes + 24 + kCountBytes;
  if (payload.size() < kShortest16) return std::nullopt;
  if (payload.size() < kShortest24) return GidBytes::k16;
  // The long form's zeros are where the short one has its number of nodes, and their first name.
  const absl::string_view zeros = payload.substr(kEncapsulationBytes + 16, 8);
  return zeros.find_first_not_of('\0') == absl::string_view::npos ? GidBytes::k24 : GidBytes::k16;
}

void GidFormVotes::Heard(const Guid& participant, GidBytes form) {
  if (votes_.size() >= kVotersMax && !votes_.contains(participant)) return;
  const auto [it, is_new] = votes_.try_emplace(participant, form);
  if (!is_new && it->second == form) return;
  it->second = form;
  Recount();
}

void GidFormVotes::Gone(const Guid& participant) {
  if (votes_.erase(participant) > 0) Recount();
}

void GidFormVotes::Recount() {
  const auto of_16 = static_cast<size_t>(std::count_if(
      votes_.begin(), votes_.end(), [](const auto& vote) { return vote.second == GidBytes::k16; }));
  const size_t of_24 = votes_.size() - of_16;
  if (of_16 != of_24) form_ = of_16 > of_24 ? GidBytes::k16 : GidBytes::k24;
}

}  // namespace rips::ros2
