#include "policy_server/server/robot/sensors/sequence_track.h"

#include <algorithm>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"

namespace rips::pipeline {

void SequenceTrack::Touch(const std::string& incarnation) {
  const auto it = std::find(recent_.begin(), recent_.end(), incarnation);
  if (it != recent_.end()) recent_.erase(it);
  recent_.push_back(incarnation);
  if (recent_.size() <= kIncarnationsMax) return;
  judged_.erase({recent_.front(), Lane::kControl});
  judged_.erase({recent_.front(), Lane::kMessages});
  recent_.erase(recent_.begin());
}

void SequenceTrack::Load(const std::string& incarnation, Lane lane, uint64_t judged) {
  if (std::find(recent_.begin(), recent_.end(), incarnation) == recent_.end()) {
    recent_.push_back(incarnation);
  }
  uint64_t& held = judged_[{incarnation, lane}];
  held = std::max(held, judged);
}

void SequenceTrack::Announce(const std::string& incarnation) {
  const auto it = std::find(recent_.begin(), recent_.end(), incarnation);
  if (it != recent_.end()) std::rotate(it, it + 1, recent_.end());
}

void SequenceTrack::KeepOnly(const SequenceTrack& other) {
  std::erase_if(judged_, [&](const auto& each) { return !other.judged_.contains(each.first); });
  std::erase_if(recent_, [&](const std::string& incarnation) {
    return std::find(other.recent_.begin(), other.recent_.end(), incarnation) ==
           other.recent_.end();
  });
}

void SequenceTrack::Restore(const std::string& incarnation, Lane lane, uint64_t judged) {
  Touch(incarnation);
  uint64_t& held = judged_[{incarnation, lane}];
  held = std::max(held, judged);
}

absl::StatusOr<SequenceTrack::Accepted> SequenceTrack::Accept(const std::string& incarnation,
                                                              Lane lane, uint64_t first,
                                                              size_t count) {
  if (first == 0 || first > kSequenceMax || count > kSequenceMax - first) {
    return absl::InvalidArgumentError(
        absl::StrCat("batch of ", count, " observations cannot start at sequence ", first));
  }
  Touch(incarnation);
  uint64_t& judged = judged_[{incarnation, lane}];
  Accepted accepted;
  if (first > judged + 1) {
    accepted.missing = first - judged - 1;
    if (lane == Lane::kControl) {
      return absl::InvalidArgumentError(absl::StrCat("control observation ", judged + 1,
                                                     " is missing; the batch starts at ", first));
    }
  } else {
    accepted.skip = static_cast<size_t>(std::min<uint64_t>(judged + 1 - first, count));
  }
  judged = std::max<uint64_t>(judged, first + count - 1);
  return accepted;
}

uint64_t SequenceTrack::Judged(const std::string& incarnation, Lane lane) const {
  const auto it = judged_.find({incarnation, lane});
  return it == judged_.end() ? 0 : it->second;
}

}  // namespace rips::pipeline
