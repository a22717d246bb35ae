#include "services/rpc/flood_watch.h"

#include <string>

namespace rips::rpc {
namespace {

constexpr char kAll[] = "";
// Sources of one window; those beyond it are counted together.
constexpr size_t kSourcesMax = 8'192;

}  // namespace

void FloodWatch::BeginWindow(int64_t now_ns) {
  begun_ns_ = now_ns;
  sources_.clear();
  others_ = 0;
  absl::erase_if(told_ns_,
                 [&](const auto& told) { return now_ns - told.second >= limits_.told_ns; });
}

std::optional<FloodWatch::Flood> FloodWatch::Count(const std::string& source, int64_t now_ns) {
  if (now_ns - begun_ns_ >= limits_.window_ns) BeginWindow(now_ns);
  const bool own = sources_.size() < kSourcesMax || sources_.contains(source);
  Source& of_it = sources_[own ? source : kAll];
  ++of_it.refused;
  if (!of_it.told) ++others_;
  const int64_t within_ns = now_ns - begun_ns_;
  if (own && !of_it.told && of_it.refused >= limits_.of_source) {
    of_it.told = true;
    others_ -= of_it.refused;
    if (!told_ns_.try_emplace(source, now_ns).second) return std::nullopt;
    return Flood{.source = source, .refused = of_it.refused, .within_ns = within_ns};
  }
  if (of_it.told || others_ < limits_.of_all) return std::nullopt;
  if (!told_ns_.try_emplace(kAll, now_ns).second) return std::nullopt;
  size_t sources = 0;
  for (const auto& [name, each] : sources_) sources += each.told ? 0 : 1;
  return Flood{.source = source, .sources = sources, .refused = others_, .within_ns = within_ns};
}

}  // namespace rips::rpc
