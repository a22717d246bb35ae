#include "services/rpc/flood_watch.h"

#include <algorithm>
#include <string>

namespace rips::rpc {
namespace {

// Of the sources beyond the first kSourcesMax of a window, which are counted together.
constexpr char kRest[] = "";
constexpr size_t kSourcesMax = 8'192;

}  // namespace

void FloodWatch::BeginWindow(int64_t now_ns) {
  begun_ns_ = now_ns;
  sources_.clear();
  others_ = 0;
  absl::erase_if(reported_ns_,
                 [&](const auto& reported) { return now_ns - reported.second >= limits_.told_ns; });
  const int64_t more = (now_ns - named_ns_) / limits_.told_ns;
  names_left_ = static_cast<int>(std::min<int64_t>(names_left_ + more, limits_.named));
  named_ns_ += more * limits_.told_ns;
}

std::optional<FloodWatch::Flood> FloodWatch::Count(const std::string& source, int64_t now_ns) {
  if (now_ns - begun_ns_ >= limits_.window_ns) BeginWindow(now_ns);
  const bool own = sources_.size() < kSourcesMax || sources_.contains(source);
  const int refused = ++sources_[own ? source : kRest];
  if (own && Reported(source)) return std::nullopt;
  ++others_;
  if (own && refused >= limits_.of_source && names_left_ > 0) {
    --names_left_;
    others_ -= refused;
    reported_ns_[source] = now_ns;
    return Flood{.source = source,
                 .of_source = refused,
                 .refused = refused,
                 .within_ns = now_ns - begun_ns_};
  }
  if (others_ < limits_.of_all) return std::nullopt;
  if (all_reported_ns_ && now_ns - *all_reported_ns_ < limits_.told_ns) return std::nullopt;
  all_reported_ns_ = now_ns;
  return All(now_ns);
}

FloodWatch::Flood FloodWatch::All(int64_t now_ns) const {
  Flood flood{.sources = 0, .refused = others_, .within_ns = now_ns - begun_ns_};
  for (const auto& [source, refused] : sources_) {
    if (Reported(source)) continue;
    ++flood.sources;
    if (source == kRest || refused <= flood.of_source) continue;
    flood.source = source;
    flood.of_source = refused;
  }
  return flood;
}

}  // namespace rips::rpc
