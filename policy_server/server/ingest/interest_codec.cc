#include "policy_server/server/ingest/interest_codec.h"

#include <openssl/evp.h>

#include <algorithm>
#include <array>
#include <string>
#include <utility>
#include <vector>

#include "services/base/check.h"

namespace rips::ingest {
namespace {

std::string Sha256(const std::string& bytes) {
  std::array<unsigned char, kInterestIdBytes> digest;
  unsigned int size = 0;
  const int ok =
      EVP_Digest(bytes.data(), bytes.size(), digest.data(), &size, EVP_sha256(), nullptr);
  RIPS_CHECK(ok == 1 && size == digest.size(), "SHA-256 is always available");
  return std::string(digest.begin(), digest.end());
}

rips::v1::InterestRule::Depth EncodeDepth(engine::Depth depth) {
  switch (depth) {
    case engine::Depth::kNothing:
      return rips::v1::InterestRule::NOTHING;
    case engine::Depth::kMetadata:
      return rips::v1::InterestRule::METADATA;
    case engine::Depth::kPayload:
      return rips::v1::InterestRule::PAYLOAD;
  }
  return rips::v1::InterestRule::DEPTH_UNSPECIFIED;
}

}  // namespace

rips::v1::Interest EncodeInterest(const engine::InterestPlan& plan,
                                  const engine::PayloadLimits& limits,
                                  const ros2::TopicNames& kept_topics) {
  rips::v1::Interest interest;
  for (const engine::TopicInterest& topic : plan) {
    rips::v1::InterestRule* rule = interest.add_rules();
    rule->set_topic_regex(topic.topic_regex);
    rule->set_depth(EncodeDepth(topic.depth));
    rule->set_payload_bytes_max(topic.payload_bytes_max);
  }
  for (const engine::PayloadLimit& limit : limits) {
    rips::v1::PayloadLimit* out = interest.add_payload_limits();
    out->set_topic_regex(limit.topic_regex);
    out->set_bytes(limit.bytes);
  }
  // In an order that does not depend on the process.
  std::vector<std::string> kept(kept_topics.begin(), kept_topics.end());
  std::sort(kept.begin(), kept.end());
  for (std::string& topic : kept) interest.add_kept_topics(std::move(topic));
  interest.set_id(Sha256(interest.SerializeAsString()));
  return interest;
}

}  // namespace rips::ingest
