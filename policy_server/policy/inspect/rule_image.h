// The compiled YARA files of one policy in memory that scanner processes share.
#ifndef RIPS_POLICY_SERVER_POLICY_INSPECT_RULE_IMAGE_H_
#define RIPS_POLICY_SERVER_POLICY_INSPECT_RULE_IMAGE_H_

#include <memory>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "policy_server/policy/inspect/yara_rules.h"
#include "services/runtime/unique_fd.h"

namespace rips::inspect {

// Immutable; any thread.
class RuleImage {
 public:
  // A scanner knows the files by their place in `files`. Unavailable: no memory or descriptor; as
  // YaraRules::Serialize else, during which nobody may scan with them.
  static absl::StatusOr<std::shared_ptr<const RuleImage>> Create(
      const std::vector<std::shared_ptr<const YaraRules>>& files);

  // As jail_spec.h describes it; sealed.
  int fd() const { return memory_.get(); }

 private:
  explicit RuleImage(UniqueFd memory) : memory_(std::move(memory)) {}

  const UniqueFd memory_;
};

}  // namespace rips::inspect

#endif  // RIPS_POLICY_SERVER_POLICY_INSPECT_RULE_IMAGE_H_
