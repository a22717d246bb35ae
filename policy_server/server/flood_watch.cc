#include "policy_server/server/flood_watch.h"

#include <algorithm>
#include <string>
#include <tuple>

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

int FloodWatch::Add(Window& window, int64_t now_ns) const {
  const int lately = Lately(window, now_ns) + 1;
  ++window.count;
  return lately;
}

FloodWatch::Source* FloodWatch::Find(const std::string& source) {
  const auto it = sources_.find(source);
  if (it != sources_.end()) return &it->second;
  if (sources_.size() >= kSourcesMax) {
    absl::erase_if(sources_, [](const auto& each) { return each.second.part.count == 0; });
  }
  if (sources_.size() >= kSourcesMax) {
    // Misra and Gries: take one off each, so that the loud ones stay.
    forgotten_ = true;
    absl::erase_if(sources_, [](auto& each) { return --each.second.part.count == 0; });
    if (sources_.size() >= kSourcesMax) return nullptr;
  }
  Source& fresh = sources_[source];
  fresh.part.source = source;
  return &fresh;
}

bool FloodWatch::TakeName(const Source& source, bool reached) {
  const auto reported = reported_.find(source.part.source);
  if (reported != reported_.end()) {
    // What it was refused for before says nothing of this.
    return limits_.gravest_first && source.part.rank > reported->second.rank;
  }
  if (!reached || names_left_ <= 0) return false;
  --names_left_;
  return true;
}

std::optional<FloodWatch::Report> FloodWatch::Count(const Refused& refused, int64_t now_ns) {
  if (minute_ns_ == 0) minute_ns_ = now_ns;
  ++in_minute_;
  Source* source = Find(refused.source);
  if (source == nullptr) return ReportAll(now_ns);
  Part& part = source->part;
  ++part.count;
  if (++part.by_rank[refused.rank] == static_cast<uint64_t>(limits_.of_source)) {
    part.rank = std::max(part.rank, refused.rank);
  }
  if (!refused.detail.empty()) part.detail = refused.detail;
  const int lately = Add(source->lately, now_ns);
  const bool reached = lately >= limits_.of_source;
  if (reached) exceeded_ns_ = now_ns;
  const bool reported = reported_.contains(refused.source);
  if (!TakeName(*source, reached)) {
    if (reported) return std::nullopt;
    ++source->in_others;
    return ReportAll(now_ns);
  }
  // Of several ranks, perhaps none has reached the limit by itself yet.
  const auto most = std::max_element(part.by_rank.begin(), part.by_rank.end());
  reported_[refused.source] = {
      .at_ns = now_ns, .rank = std::max(part.rank, static_cast<int>(most - part.by_rank.begin()))};
  const int in_count = std::min(others_.count, source->in_others);
  others_.count -= in_count;
  others_.before = std::max(0, others_.before - (source->in_others - in_count));
  Report report{.kind = Report::Kind::kSource,
                .most = {part},
                .count = static_cast<uint64_t>(lately),
                .within_ns = source->lately.before > 0 ? limits_.window_ns
                                                       : now_ns - source->lately.begun_ns};
  // A higher rank is due by the minute's count.
  if (reported) {
    report.count = part.count;
    report.within_ns = now_ns - minute_ns_;
  }
  return report;
}

// One more of those that are not reported by themselves.
std::optional<FloodWatch::Report> FloodWatch::ReportAll(int64_t now_ns) {
  const int lately = Add(others_, now_ns);
  if (lately < limits_.of_all) return std::nullopt;
  exceeded_ns_ = now_ns;
  if (all_reported_ns_ && now_ns - *all_reported_ns_ < limits_.again_ns) return std::nullopt;
  all_reported_ns_ = now_ns;
  return Report{.kind = Report::Kind::kAll,
                .most = Most(),
                .sources = sources_.size(),
                .count = static_cast<uint64_t>(lately),
                .within_ns = others_.before > 0 ? limits_.window_ns : now_ns - others_.begun_ns};
}

std::vector<FloodWatch::Part> FloodWatch::Most() const {
  const auto before = [this](const Part& a, const Part& b) {
    const int rank_a = limits_.gravest_first ? a.rank : 0;
    const int rank_b = limits_.gravest_first ? b.rank : 0;
    return std::tie(rank_a, a.count) > std::tie(rank_b, b.count);
  };
  std::vector<Part> most;
  for (const auto& [name, source] : sources_) {
    if (source.part.count == 0) continue;
    if (most.size() == kMostMax && !before(source.part, most.back())) continue;
    if (most.size() == kMostMax) most.pop_back();
    most.insert(std::upper_bound(most.begin(), most.end(), source.part, before), source.part);
  }
  return most;
}

std::optional<FloodWatch::Report> FloodWatch::Poll(int64_t now_ns) {
  if (now_ns - minute_ns_ < kMinuteNs) return std::nullopt;
  std::optional<Report> report;
  if (exceeded_ns_ || began_) {
    const auto active = [](const auto& each) { return each.second.part.count > 0; };
    report = Report{
        .kind = exceeded_ns_ ? Report::Kind::kMinute : Report::Kind::kOver,
        .most = Most(),
        .sources = static_cast<size_t>(std::count_if(sources_.begin(), sources_.end(), active)),
        .counted = !forgotten_,
        .count = in_minute_,
        .within_ns = now_ns - minute_ns_,
        .goes_on = exceeded_ns_ && now_ns - *exceeded_ns_ < limits_.window_ns};
    if (forgotten_) report->sources = kSourcesMax;
  }
  minute_ns_ = now_ns;
  in_minute_ = 0;
  forgotten_ = false;
  began_ = exceeded_ns_.has_value();
  exceeded_ns_.reset();
  names_left_ = std::min(names_left_ + 1, limits_.named);
  absl::erase_if(reported_,
                 [&](const auto& each) { return now_ns - each.second.at_ns >= limits_.again_ns; });
  absl::erase_if(sources_, [&](auto& each) {
    Part& part = each.second.part;
    part = {.source = part.source};
    each.second.in_others = 0;
    return Lately(each.second.lately, now_ns) == 0;
  });
  return report;
}

}  // namespace rips
