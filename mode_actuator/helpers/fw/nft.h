// Port: the kernel's packet filter.
#ifndef RIPS_MODE_ACTUATOR_HELPERS_FW_NFT_H_
#define RIPS_MODE_ACTUATOR_HELPERS_FW_NFT_H_

#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::actuator {

enum class NftMode { kDryRun, kCommit };

// One thread at a time.
class Nft {
 public:
  virtual ~Nft() = default;

  // One transaction. InvalidArgument with nft's own words if nft or the kernel refuses it; then
  // nothing has changed. Unavailable if nft cannot be run, DeadlineExceeded if it had to be killed:
  // then it may have happened.
  virtual absl::Status Load(absl::string_view script, NftMode mode) = 0;

  // What `nft -j list table inet rips` prints. NotFound if there is no such table; else as above.
  virtual absl::StatusOr<std::string> ListTable() = 0;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_HELPERS_FW_NFT_H_
