#include "sensor_agent/interest/interest_file.h"

#include <openssl/evp.h>

#include <array>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "services/base/check.h"
#include "services/base/status_macros.h"
#include "services/runtime/atomic_file.h"

namespace rips::sensor {

std::string InterestFile(const std::string& state_dir) {
  return absl::StrCat(state_dir, "/interest");
}

absl::StatusOr<std::shared_ptr<const Interest>> InterestFromWire(const rips::v1::Interest& wire) {
  std::vector<InterestRule> rules;
  for (const rips::v1::InterestRule& rule : wire.rules()) {
    InterestRule& taken =
        rules.emplace_back(InterestRule{.topic_regex = rule.topic_regex(), .type = rule.type()});
    switch (rule.depth()) {
      case rips::v1::InterestRule::NOTHING:
        taken.messages = false;
        break;
      case rips::v1::InterestRule::METADATA:
        break;
      case rips::v1::InterestRule::PAYLOAD:
        taken.payload_bytes_max = rule.payload_bytes_max();
        break;
      default:
        return absl::InvalidArgumentError(absl::StrCat(
            "rule ", rules.size(), ": depth ", static_cast<int>(rule.depth()), " is not known"));
    }
  }
  std::vector<PayloadLimit> limits;
  for (const rips::v1::PayloadLimit& limit : wire.payload_limits()) {
    limits.push_back({.topic_regex = limit.topic_regex(), .bytes = limit.bytes()});
  }
  return Interest::Create(wire.id(), std::move(rules), std::move(limits),
                          {wire.kept_topics().begin(), wire.kept_topics().end()});
}

std::string InterestId(rips::v1::Interest interest) {
  interest.clear_id();
  const std::string bytes = interest.SerializeAsString();
  std::array<unsigned char, kInterestIdBytes> digest;
  unsigned int size = 0;
  const int ok =
      EVP_Digest(bytes.data(), bytes.size(), digest.data(), &size, EVP_sha256(), nullptr);
  RIPS_CHECK(ok == 1 && size == digest.size(), "SHA-256 is always available");
  return std::string(digest.begin(), digest.end());
}

absl::Status SaveInterest(const std::string& path, const rips::v1::Interest& interest) {
  return WriteFileAtomically(path, interest.SerializeAsString());
}

absl::StatusOr<std::shared_ptr<const Interest>> LoadInterest(const std::string& path) {
  RIPS_ASSIGN_OR_RETURN(const std::string bytes, ReadFile(path, kInterestFileBytesMax));
  rips::v1::Interest wire;
  if (!wire.ParseFromString(bytes)) return absl::DataLossError("it is no interest");
  if (wire.id() != InterestId(wire)) return absl::DataLossError("its id is not its checksum");
  return InterestFromWire(wire);
}

}  // namespace rips::sensor
