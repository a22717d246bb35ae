// Whatever a server asks a sensor to watch is taken within its limits or refused, and one that is
// taken answers for every topic. What our own server asks of the same rows is taken or refused
// likewise, and answered as the first row says that matches.
#include <cstddef>
#include <cstdint>
#include <string>

#include "policy_server/server/ingest/interest_codec.h"
#include "sensor_agent/interest/interest_file.h"
#include "services/base/check.h"
#include "services/base/payload_limits.h"

namespace rips {
namespace {

constexpr const char* kTopics[] = {"/cmd_vel", "/camera/image_raw", "/rosout", "/a", ""};
// Compiling patterns is slow, and many of them find nothing new.
constexpr int kRulesMax = 40;

engine::InterestPlan PlanOf(const rips::v1::Interest& wire) {
  engine::InterestPlan plan;
  for (const rips::v1::InterestRule& rule : wire.rules()) {
    engine::TopicInterest& row = plan.emplace_back();
    row.topic_regex = rule.topic_regex();
    row.depth = rule.depth() == rips::v1::InterestRule::NOTHING    ? engine::Depth::kNothing
                : rule.depth() == rips::v1::InterestRule::METADATA ? engine::Depth::kMetadata
                                                                   : engine::Depth::kPayload;
    row.payload_bytes_max = row.depth == engine::Depth::kPayload ? rule.payload_bytes_max() : 0;
  }
  return plan;
}

void CheckAnswers(const engine::InterestPlan& plan, const sensor::Interest& interest) {
  for (const char* topic : kTopics) {
    const sensor::Wanted wanted = interest.Of(topic, "std_msgs/msg/String");
    const engine::TopicInterest* first = nullptr;
    for (const engine::TopicInterest& row : plan) {
      if (!row.topic_regex.empty() && !RE2::PartialMatch(topic, RE2(row.topic_regex))) continue;
      first = &row;
      break;
    }
    const bool messages = first != nullptr && first->depth != engine::Depth::kNothing;
    RIPS_CHECK(wanted.messages == messages, "another row was taken");
    RIPS_CHECK(wanted.payload_bytes <= kPayloadBytesHard, "past the limit");
  }
}

}  // namespace
}  // namespace rips

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace rips;  // One translation unit, nothing else in it.
  if (size > 20'000) return 0;
  rips::v1::Interest wire;
  if (!wire.ParseFromArray(data, static_cast<int>(size)) || wire.rules_size() > kRulesMax) return 0;
  const auto hostile = sensor::InterestFromWire(wire);
  if (hostile.ok()) {
    for (const char* topic : kTopics) {
      const sensor::Wanted wanted = (*hostile)->Of(topic, "std_msgs/msg/String");
      RIPS_CHECK(wanted.messages || wanted.payload_bytes == 0, "payloads of no message");
      RIPS_CHECK(wanted.payload_bytes <= kPayloadBytesHard, "past the limit");
    }
  }
  const engine::InterestPlan plan = PlanOf(wire);
  const rips::v1::Interest encoded = ingest::EncodeInterest(plan);
  RIPS_CHECK(sensor::InterestId(encoded) == encoded.id(), "the id is not the checksum");
  const auto taken = sensor::InterestFromWire(encoded);
  if (taken.ok()) CheckAnswers(plan, **taken);
  return 0;
}
