#include "sensor_agent/interest.h"

#include <algorithm>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "services/ros2/ros_name.h"

namespace rips::sensor {

namespace {

std::unique_ptr<const RE2> Compile(const std::string& pattern, int64_t memory) {
  RE2::Options options;
  options.set_log_errors(false);
  options.set_max_mem(memory);
  return std::make_unique<const RE2>(pattern, options);
}

absl::StatusOr<std::unique_ptr<const RE2>> Compile(const std::string& pattern) {
  std::unique_ptr<const RE2> regex = Compile(pattern, kInterestPatternBytes);
  if (regex->error_code() == RE2::ErrorPatternTooLarge) {
    regex = Compile(pattern, kInterestPatternBytesMax);
  }
  if (regex->ok()) return regex;
  if (regex->error_code() == RE2::ErrorPatternTooLarge) {
    return absl::ResourceExhaustedError(
        absl::StrCat("the pattern needs more than ", kInterestPatternBytesMax, " bytes"));
  }
  return absl::InvalidArgumentError(absl::StrCat("bad pattern: ", regex->error()));
}

// The text that a pattern without operators matches; empty if it has any.
std::string Unquote(absl::string_view pattern) {
  std::string text;
  for (size_t i = 0; i < pattern.size(); ++i) {
    char c = pattern[i];
    if (c == '\\') {
      // Behind a backslash letters and digits mean something else.
      if (++i == pattern.size() || absl::ascii_isalnum(pattern[i])) return {};
      c = pattern[i];
    } else if (!absl::ascii_isalnum(c) && c != '_' && c != '/') {
      return {};
    }
    text.push_back(c);
  }
  return text;
}

}  // namespace

std::vector<std::string> LiteralTopics(absl::string_view regex) {
  if (!absl::ConsumePrefix(&regex, "^") || !absl::ConsumeSuffix(&regex, "$")) return {};
  const bool group = absl::ConsumePrefix(&regex, "(?:");
  if (group && !absl::ConsumeSuffix(&regex, ")")) return {};
  std::vector<std::string> names;
  // A topic name has no bar, so a quoted one makes a name that is refused.
  for (absl::string_view pattern : absl::StrSplit(regex, '|')) {
    std::string name = Unquote(pattern);
    if (!ros2::ValidateTopicName(name).ok()) return {};
    names.push_back(std::move(name));
  }
  // Without a group `^a|b$` is two patterns, each open at one end.
  if (names.size() > 1 && !group) return {};
  return names;
}

absl::StatusOr<std::shared_ptr<const Interest>> Interest::Create(std::string id,
                                                                 std::vector<InterestRule> rules) {
  if (id.size() != kInterestIdBytes) {
    return absl::InvalidArgumentError(
        absl::StrCat("the id has ", id.size(), " bytes, not ", kInterestIdBytes));
  }
  if (rules.size() > kInterestRulesMax) {
    return absl::ResourceExhaustedError(
        absl::StrCat(rules.size(), " rules exceed the limit of ", kInterestRulesMax));
  }
  std::shared_ptr<Interest> interest(new Interest(std::move(id)));
  size_t instructions = 0;
  for (size_t i = 0; i < rules.size(); ++i) {
    Rule rule{.type = std::move(rules[i].type)};
    if (rules[i].messages) {
      rule.wanted = {.messages = true,
                     .payload_bytes = std::min(rules[i].payload_bytes_max, kPayloadBytesMax)};
      for (std::string& name : LiteralTopics(rules[i].topic_regex)) {
        interest->literal_.insert(std::move(name));
      }
    }
    if (!rules[i].topic_regex.empty()) {
      absl::StatusOr<std::unique_ptr<const RE2>> regex = Compile(rules[i].topic_regex);
      if (!regex.ok()) {
        return absl::Status(regex.status().code(),
                            absl::StrCat("rule ", i + 1, ": ", regex.status().message()));
      }
      rule.topic = *std::move(regex);
      instructions += static_cast<size_t>(rule.topic->ProgramSize());
    }
    if (instructions > kInterestInstructionsMax) {
      return absl::ResourceExhaustedError(
          absl::StrCat("rule ", i + 1, ": with it, the patterns exceed the limit of ",
                       kInterestInstructionsMax, " instructions"));
    }
    interest->rules_.push_back(std::move(rule));
  }
  return interest;
}

Wanted Interest::Of(absl::string_view topic, absl::string_view type) const {
  const re2::StringPiece name(topic.data(), topic.size());
  for (const Rule& rule : rules_) {
    if (!rule.type.empty() && rule.type != type) continue;
    if (rule.topic == nullptr || RE2::PartialMatch(name, *rule.topic)) return rule.wanted;
  }
  return {};
}

Wanted WatchPlan::Of(absl::string_view topic, absl::string_view type) const {
  if (options_.idle) return {};
  const auto key = std::make_pair(std::string(topic), std::string(type));
  if (const auto known = answers_.find(key); known != answers_.end()) return known->second;
  if (answers_.size() >= kWatchAnswersMax) answers_.clear();
  return answers_[key] = Find(topic, type);
}

Wanted WatchPlan::Find(absl::string_view topic, absl::string_view type) const {
  const Interest* interest = options_.interest.get();
  const auto& unwatched = options_.unwatched;
  if (std::find(unwatched.begin(), unwatched.end(), topic) != unwatched.end() &&
      (interest == nullptr || !interest->Names(topic))) {
    return {};
  }
  return interest == nullptr ? Wanted{.messages = true} : interest->Of(topic, type);
}

}  // namespace rips::sensor
