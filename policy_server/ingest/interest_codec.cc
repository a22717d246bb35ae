#include "policy_server/ingest/interest_codec.h"

#include <openssl/evp.h>

#include <array>
#include <string>

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
                                  const engine::PayloadLimits& limits) {
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
  interest.set_id(Sha256(interest.SerializeAsString()));
  return interest;
}

}  // namespace rips::ingest
