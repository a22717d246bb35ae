// Runs /usr/sbin/nft, a process each time.
#ifndef RIPS_MODE_ACTUATOR_HELPERS_FW_NFT_RUNNER_H_
#define RIPS_MODE_ACTUATOR_HELPERS_FW_NFT_RUNNER_H_

#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "mode_actuator/helpers/fw/nft.h"
#include "services/runtime/run_to_end.h"

namespace rips::actuator {

inline constexpr absl::Duration kNftTimeout = absl::Milliseconds(1500);
// Of what nft says went wrong.
inline constexpr size_t kNftErrorBytesMax = 512;

// As RunToEnd.
class NftRunner final : public Nft {
 public:
  struct Options {
    std::string path = "/usr/sbin/nft";
    absl::Duration timeout = kNftTimeout;  // then SIGKILL
  };
  explicit NftRunner(Options options) : options_(std::move(options)) {}

  absl::Status Load(absl::string_view script, NftMode mode) override;
  absl::StatusOr<std::string> ListTable() override;

 private:
  // Errors of RunToEnd, which it is; kRulesetBytesMax may be printed.
  absl::StatusOr<ProgramEnd> Run(const std::vector<std::string>& args,
                                 absl::string_view input) const;

  const Options options_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_HELPERS_FW_NFT_RUNNER_H_
