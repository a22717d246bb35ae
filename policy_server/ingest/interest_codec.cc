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

}  // namespace

rips::v1::Interest EncodeInterest(const std::vector<engine::TopicInterest>& topics) {
  rips::v1::Interest interest;
  for (const engine::TopicInterest& topic : topics) {
    rips::v1::InterestRule* rule = interest.add_rules();
    rule->set_topic_regex(topic.topic_regex);
    rule->set_depth(rips::v1::InterestRule::PAYLOAD);
    rule->set_payload_bytes_max(topic.payload_bytes_max);
  }
  interest.add_rules()->set_depth(rips::v1::InterestRule::METADATA);
  interest.set_id(Sha256(interest.SerializeAsString()));
  return interest;
}

}  // namespace rips::ingest
