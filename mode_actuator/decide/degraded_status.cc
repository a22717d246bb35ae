#include "mode_actuator/decide/degraded_status.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "services/ros2/ros_name.h"

namespace rips::actuator {

std::vector<std::string> LimitDegraded(std::vector<std::string> texts) {
  constexpr absl::string_view kCut = "...";
  if (texts.size() > kDegradedMax) {
    const size_t more = texts.size() - (kDegradedMax - 1);
    texts.resize(kDegradedMax - 1);
    texts.push_back(absl::StrCat("and ", more, " more"));
  }
  for (std::string& text : texts) {
    text = ros2::Printable(text);
    if (text.size() <= kDegradedBytesMax) continue;
    text.resize(kDegradedBytesMax - kCut.size());
    absl::StrAppend(&text, kCut);
  }
  return texts;
}

void DegradedStatus::Set(absl::string_view source, std::vector<std::string> texts) {
  MutexLock lock(&mu_);
  by_source_[std::string(source)] = std::move(texts);
}

std::vector<std::string> DegradedStatus::All() const {
  MutexLock lock(&mu_);
  std::vector<std::string> all;
  for (const auto& [source, texts] : by_source_) all.insert(all.end(), texts.begin(), texts.end());
  return all;
}

}  // namespace rips::actuator
