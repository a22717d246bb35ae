#include "sensor_agent/interest.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"

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

}  // namespace

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
    Rule rule{.type = std::move(rules[i].type),
              .payload_bytes_max = std::min(rules[i].payload_bytes_max, kPayloadBytesMax)};
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

uint32_t Interest::PayloadBytes(absl::string_view topic, absl::string_view type) const {
  const re2::StringPiece name(topic.data(), topic.size());
  for (const Rule& rule : rules_) {
    if (!rule.type.empty() && rule.type != type) continue;
    if (rule.topic == nullptr || RE2::PartialMatch(name, *rule.topic)) {
      return rule.payload_bytes_max;
    }
  }
  return 0;
}

}  // namespace rips::sensor
