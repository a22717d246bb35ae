#include "policy_server/policy/engine/interest/merge_interest.h"

#include <algorithm>
#include <map>
#include <optional>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "services/base/payload_limits.h"

namespace rips::engine {
namespace {

// The one topic that a pattern matches which is made of a name, its characters quoted or not. It
// may be none: then it is taken as any pattern.
std::optional<std::string> NameOf(const std::string& regex) {
  if (regex.size() < 3 || regex.front() != '^' || regex.back() != '$') return std::nullopt;
  std::string name;
  for (size_t i = 1; i + 1 < regex.size(); ++i) {
    const bool quoted = regex[i] == '\\';
    if (quoted && ++i + 1 == regex.size()) return std::nullopt;
    const auto c = static_cast<unsigned char>(regex[i]);
    const bool word = absl::ascii_isalnum(c);
    // Behind a backslash letters and digits mean something else.
    if (quoted ? word : !word && c != '_' && c != '/' && c < 0x80) return std::nullopt;
    name.push_back(regex[i]);
  }
  return name;
}

void AddReasons(const std::vector<std::string>& from, std::vector<std::string>& to) {
  to.insert(to.end(), from.begin(), from.end());
  std::sort(to.begin(), to.end());
  to.erase(std::unique(to.begin(), to.end()), to.end());
  if (to.size() > kWantedByMax) to.resize(kWantedByMax);
}

// The most bytes that the plan asks for where no limit matches; 0 = it asks for no payload.
uint32_t MostBytes(const InterestPlan& plan) {
  uint32_t bytes = 0;
  for (const TopicInterest& row : plan) bytes = std::max(bytes, row.payload_bytes_max);
  return bytes;
}

bool Deeper(const TopicInterest& a, const TopicInterest& b) {
  return std::tuple(a.depth, a.payload_bytes_max) > std::tuple(b.depth, b.payload_bytes_max);
}

class Merger {
 public:
  Merger(const Interest& first, const Interest& second)
      : first_(first),
        second_(second),
        of_first_(first),
        of_second_(second),
        plan_of_first_({.plan = first.plan, .limits = {}}),
        plan_of_second_({.plan = second.plan, .limits = {}}) {}

  Interest Run() {
    Interest merged{.plan = Plan(), .limits = Limits()};
    const InterestReader reader(merged);
    const bool affordable = merged.plan.size() <= kMergedInterestsMax &&
                            merged.limits.size() <= kPayloadLimitsMax &&
                            reader.instructions() <= kInterestInstructionsMax;
    return affordable ? merged : Everything();
  }

 private:
  // What the deeper of both asks for of a topic, by their limits too or by their plans alone.
  Need NeedOf(const std::string& topic, bool limited) {
    const Need a = (limited ? of_first_ : plan_of_first_).Of(topic);
    const Need b = (limited ? of_second_ : plan_of_second_).Of(topic);
    return {std::max(a.depth, b.depth), std::max(a.payload_bytes, b.payload_bytes)};
  }

  InterestPlan Plan() {
    InterestPlan merged;
    // Where in `merged` it is.
    std::map<std::string, size_t> names;
    TopicInterest rest;
    rest.depth = Depth::kNothing;
    InterestPlan patterns;
    for (const InterestPlan* plan : {&first_.plan, &second_.plan}) {
      for (const TopicInterest& row : *plan) {
        if (const std::optional<std::string> name = NameOf(row.topic_regex)) {
          const auto [it, fresh] = names.emplace(*name, merged.size());
          if (fresh) merged.push_back(row);
          AddReasons(row.wanted_by, merged[it->second].wanted_by);
        } else if (row.topic_regex.empty()) {
          // What comes after is never read.
          Raise(row, rest);
          break;
        } else {
          patterns.push_back(row);
        }
      }
    }
    for (const auto& [name, at] : names) {
      const Need need = NeedOf(name, /*limited=*/false);
      merged[at].depth = need.depth;
      merged[at].payload_bytes_max = need.payload_bytes;
    }
    Sort(patterns, rest);
    std::move(patterns.begin(), patterns.end(), std::back_inserter(merged));
    merged.push_back(std::move(rest));
    return merged;
  }

  static void Raise(const TopicInterest& by, TopicInterest& row) {
    row.depth = std::max(row.depth, by.depth);
    row.payload_bytes_max = std::max(row.payload_bytes_max, by.payload_bytes_max);
    AddReasons(by.wanted_by, row.wanted_by);
  }

  // The deepest first, one of each regex, none that asks for no more than `rest`.
  static void Sort(InterestPlan& patterns, TopicInterest& rest) {
    std::stable_sort(patterns.begin(), patterns.end(), Deeper);
    InterestPlan kept;
    for (TopicInterest& row : patterns) {
      const auto same = std::find_if(kept.begin(), kept.end(), [&](const TopicInterest& other) {
        return other.topic_regex == row.topic_regex;
      });
      if (same != kept.end()) {
        AddReasons(row.wanted_by, same->wanted_by);
      } else if (Deeper(row, rest)) {
        kept.push_back(std::move(row));
      } else {
        AddReasons(row.wanted_by, rest.wanted_by);
      }
    }
    patterns = std::move(kept);
  }

  PayloadLimits Limits() {
    if (first_.limits == second_.limits) return first_.limits;
    std::map<std::string, PayloadLimit> names;
    PayloadLimits patterns;
    const auto add = [&](const PayloadLimits& limits, uint32_t at_least) {
      for (const PayloadLimit& limit : limits) {
        if (const std::optional<std::string> name = NameOf(limit.topic_regex)) {
          const uint32_t bytes = NeedOf(*name, /*limited=*/true).payload_bytes;
          names[*name] = {limit.topic_regex, bytes > 0 ? bytes : limit.bytes};
        } else {
          patterns.push_back({limit.topic_regex, std::max(limit.bytes, at_least)});
        }
      }
    };
    add(first_.limits, MostBytes(second_.plan));
    add(second_.limits, MostBytes(first_.plan));
    std::stable_sort(
        patterns.begin(), patterns.end(),
        [](const PayloadLimit& a, const PayloadLimit& b) { return a.bytes > b.bytes; });
    PayloadLimits merged;
    for (auto& [name, limit] : names) merged.push_back(std::move(limit));
    std::move(patterns.begin(), patterns.end(), std::back_inserter(merged));
    return merged;
  }

  Interest Everything() const {
    TopicInterest most;
    most.depth = Depth::kNothing;
    for (const Interest* each : {&first_, &second_}) {
      for (const TopicInterest& row : each->plan) Raise(row, most);
      if (most.depth != Depth::kPayload) continue;
      for (const PayloadLimit& limit : each->limits) {
        most.payload_bytes_max = std::max(most.payload_bytes_max, limit.bytes);
      }
    }
    Interest merged;
    size_t instructions = 0;
    for (const Interest* each : {&first_, &second_}) {
      for (const TopicInterest& row : each->plan) {
        if (row.depth == Depth::kNothing || !NameOf(row.topic_regex)) continue;
        TopicInterest named = most;
        named.topic_regex = row.topic_regex;
        named.wanted_by = row.wanted_by;
        instructions += InterestReader({.plan = {named}, .limits = {}}).instructions();
        const bool room = merged.plan.size() + 1 < kMergedInterestsMax &&
                          instructions <= kInterestInstructionsMax;
        if (room || each == &first_) merged.plan.push_back(std::move(named));
      }
    }
    merged.plan.push_back(std::move(most));
    return merged;
  }

  const Interest& first_;
  const Interest& second_;
  InterestReader of_first_;
  InterestReader of_second_;
  // Without their limits.
  InterestReader plan_of_first_;
  InterestReader plan_of_second_;
};

}  // namespace

Interest MergeInterest(const Interest& first, const Interest& second) {
  return Merger(first, second).Run();
}

ros2::TopicNames MergeKeptTopics(const ros2::TopicNames& first, const ros2::TopicNames& second) {
  ros2::TopicNames merged = first;
  std::vector<std::string> more(second.begin(), second.end());
  std::sort(more.begin(), more.end());
  for (std::string& name : more) {
    if (merged.size() >= ros2::kKeptTopicsMax) break;
    merged.insert(std::move(name));
  }
  return merged;
}

}  // namespace rips::engine
