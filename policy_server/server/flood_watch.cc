#include "policy_server/server/flood_watch.h"

#include <algorithm>
#include <string>
#include <utility>

namespace rips {

int FloodWatch::Lately(Window& window, int64_t now_ns) const {
  const int64_t passed = (now_ns - window.begun_ns) / limits_.window_ns;
  if (passed > 0) {
    window.before = passed == 1 ? window.count : 0;
    window.count = 0;
    // The first after a silence begins one.
    window.begun_ns = window.before == 0 ? now_ns : window.begun_ns + limits_.window_ns;
  }
  const double overlap =
      1 - static_cast<double>(now_ns - window.begun_ns) / static_cast<double>(limits_.window_ns);
  return window.count + static_cast<int>(window.before * overlap);
}

bool FloodWatch::Exceeds(Window& window, int limit, int64_t now_ns) const {
  const int lately = Lately(window, now_ns) + 1;
  ++window.count;
  return lately >= limit;
}

FloodWatch::Source* FloodWatch::Find(const std::string& source) {
  const auto it = sources_.find(source);
  if (it != sources_.end()) return &it->second;
  if (sources_.size() >= kSourcesMax) {
    // Misra and Gries: one is taken off each, so that those of many stay.
    given_up_ = true;
    absl::erase_if(sources_, [](auto& each) {
      if (each.second.in_minute > 0) --each.second.in_minute;
      return each.second.in_minute == 0;
    });
    if (sources_.size() >= kSourcesMax) return nullptr;
  }
  return &sources_[source];
}

std::optional<FloodWatch::Report> FloodWatch::Count(const Refused& refused, int64_t now_ns) {
  if (minute_ns_ == 0) minute_ns_ = now_ns;
  ++in_minute_;
  Source* source = Find(refused.source);
  bool full = false;
  bool reported = false;
  if (source != nullptr) {
    ++source->in_minute;
    source->rank = std::max(source->rank, refused.rank);
    source->detail = refused.detail;
    full = Exceeds(source->lately, limits_.of_source, now_ns);
    if (full) exceeded_ns_ = now_ns;
    reported = reported_ns_.contains(refused.source);
  }
  if (full && !reported && names_left_ > 0) {
    --names_left_;
    reported_ns_[refused.source] = now_ns;
    const Window& lately = source->lately;
    others_.count = std::max(0, others_.count - lately.count);
    others_.before = std::max(0, others_.before - lately.before);
    const auto count = static_cast<uint64_t>(limits_.of_source);
    return Report{
        .kind = Report::Kind::kSource,
        .most = {{.refused = {refused.source, source->rank, refused.detail}, .count = count}},
        .count = count,
        .within_ns = lately.before > 0 ? limits_.window_ns : now_ns - lately.begun_ns};
  }
  if (reported || !Exceeds(others_, limits_.of_all, now_ns)) return std::nullopt;
  exceeded_ns_ = now_ns;
  if (all_reported_ns_ && now_ns - *all_reported_ns_ < limits_.again_ns) return std::nullopt;
  all_reported_ns_ = now_ns;
  return Most(Report::Kind::kAll, now_ns);
}

FloodWatch::Report FloodWatch::Most(Report::Kind kind, int64_t now_ns) const {
  Report report{.kind = kind,
                .counted = !given_up_,
                .count = in_minute_,
                .within_ns = now_ns - minute_ns_,
                .goes_on = exceeded_ns_ && now_ns - *exceeded_ns_ < limits_.window_ns};
  report.sources = 0;
  std::vector<Part>& most = report.most;
  for (const auto& [name, source] : sources_) {
    if (source.in_minute == 0) continue;
    ++report.sources;
    if (most.size() == kMostMax && most.back().count >= source.in_minute) continue;
    if (most.size() == kMostMax) most.pop_back();
    const auto at = std::find_if(most.begin(), most.end(),
                                 [&](const Part& part) { return part.count < source.in_minute; });
    most.insert(at, {.refused = {name, source.rank, source.detail}, .count = source.in_minute});
  }
  return report;
}

std::optional<FloodWatch::Report> FloodWatch::Look(int64_t now_ns) {
  if (now_ns - minute_ns_ < kMinuteNs) return std::nullopt;
  std::optional<Report> report;
  if (exceeded_ns_) report = Most(Report::Kind::kMinute, now_ns);
  minute_ns_ = now_ns;
  in_minute_ = 0;
  given_up_ = false;
  exceeded_ns_.reset();
  names_left_ = std::min(names_left_ + 1, limits_.named);
  absl::erase_if(reported_ns_,
                 [&](const auto& each) { return now_ns - each.second >= limits_.again_ns; });
  absl::erase_if(sources_, [&](auto& each) {
    each.second.in_minute = 0;
    each.second.rank = 0;
    return Lately(each.second.lately, now_ns) == 0;
  });
  return report;
}

}  // namespace rips
