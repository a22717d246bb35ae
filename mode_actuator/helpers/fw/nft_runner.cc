#include "mode_actuator/helpers/fw/nft_runner.h"

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "mode_actuator/helpers/fw/ruleset.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"

namespace rips::actuator {
namespace {

constexpr absl::string_view kNoTable = "No such file or directory";

// nft's first two lines say what and where; the rest repeats the text.
std::string Reason(absl::string_view err) {
  return ros2::Printable(err.substr(0, kNftErrorBytesMax));
}

}  // namespace

absl::StatusOr<ProgramEnd> NftRunner::Run(const std::vector<std::string>& args,
                                          absl::string_view input) const {
  ProgramCall call{.words = {options_.path},
                   .environment = {"PATH=/usr/sbin:/usr/bin", "LANG=C"},
                   .input = std::string(input),
                   .timeout = options_.timeout,
                   .output_bytes_max = kRulesetBytesMax};
  call.words.insert(call.words.end(), args.begin(), args.end());
  return RunToEnd(call);
}

absl::Status NftRunner::Load(absl::string_view script, NftMode mode) {
  std::vector<std::string> args = {"-f", "-"};
  if (mode == NftMode::kDryRun) args.insert(args.begin(), "-c");
  RIPS_ASSIGN_OR_RETURN(const ProgramEnd ended, Run(args, script));
  if (ended.exit_code == 0) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("nft refuses (exit code ", ended.exit_code, "): ", Reason(ended.err)));
}

absl::StatusOr<std::string> NftRunner::ListTable() {
  RIPS_ASSIGN_OR_RETURN(ProgramEnd ended, Run({"-j", "list", "table", "inet", "rips"}, ""));
  if (ended.exit_code == 0) return std::move(ended.out);
  if (absl::StrContains(ended.err, kNoTable)) {
    return absl::NotFoundError("table `inet rips` is not there");
  }
  return absl::UnavailableError(
      absl::StrCat("nft cannot list (exit code ", ended.exit_code, "): ", Reason(ended.err)));
}

}  // namespace rips::actuator
