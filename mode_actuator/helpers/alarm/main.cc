// rips-alarm: tries the alarms of an actuator.yaml by hand.
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <iostream>
#include <memory>
#include <string>

#include "CLI/CLI.hpp"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "mode_actuator/config/config.h"
#include "mode_actuator/steps/alarm/alarm_board.h"
#include "mode_actuator/steps/alarm/drivers.h"
#include "services/base/status_macros.h"
#include "services/runtime/config_sections.h"
#include "services/runtime/daemon_flags.h"
#include "services/runtime/daemon_log.h"
#include "services/runtime/log.h"
#include "services/runtime/output_stream.h"
#include "services/runtime/real_clock.h"
#include "services/text/escape.h"

namespace rips::actuator {
namespace {

constexpr absl::Duration kPatience = absl::Seconds(5);  // finding the device included
constexpr absl::Duration kPause = absl::Milliseconds(10);

AlarmResult Carry(AlarmBoard& board, const std::string& name, AlarmOrder what,
                  const AlarmState& state) {
  const absl::StatusOr<uint64_t> order = board.Begin(name, what, state);
  if (!order.ok()) return {.status = order.status()};
  const absl::Time end = absl::Now() + kPatience;
  while (absl::Now() < end) {
    if (std::optional<AlarmResult> result = board.Poll(*order)) return *std::move(result);
    absl::SleepFor(kPause);
  }
  return {.status = absl::DeadlineExceededError(
              absl::StrCat("not over in ", absl::FormatDuration(kPatience)))};
}

// What is to be said of a device that was looked at, or why it cannot be used.
absl::StatusOr<std::string> Describe(AlarmBoard& board, const AlarmSpec& spec) {
  const AlarmResult result = Carry(board, spec.name, AlarmOrder::kRead, {});
  if (!result.status.ok() && !absl::IsFailedPrecondition(result.status)) return result.status;
  if (result.observed == "?") return "plugged in; this device cannot be read back";
  return result.observed;
}

absl::Status Run(const std::string& file, const std::string& device, const std::string& state,
                 OutputStream& out) {
  RIPS_ASSIGN_OR_RETURN(const std::string text, ReadConfigFile(file));
  RIPS_ASSIGN_OR_RETURN(const ParsedConfig parsed, ParseConfig(file, text));
  const std::vector<AlarmSpec>& devices = parsed.config.devices;
  const AlarmSpec* spec = FindNamed(devices, device);
  if (!device.empty() && spec == nullptr) {
    return absl::InvalidArgumentError(
        absl::StrCat("no device `", device, "` in `devices` of ", file));
  }
  AlarmState wanted;
  if (!state.empty()) {
    RIPS_ASSIGN_OR_RETURN(wanted, ParseAlarmState(spec->kind, state));
  }
  const RealClock clock;
  if (!state.empty()) {
    AlarmBoard board({*spec}, RealAlarms(), &clock);
    const AlarmResult result = Carry(board, device, AlarmOrder::kSet, wanted);
    if (result.status.ok()) out << device << ": " << EscapeText(result.detail) << "\n";
    return result.status;
  }
  absl::Status all;
  AlarmBoard board(device.empty() ? devices : std::vector<AlarmSpec>{*spec}, RealAlarms(), &clock);
  for (const AlarmSpec& each : devices) {
    if (!device.empty() && each.name != device) continue;
    const absl::StatusOr<std::string> said = Describe(board, each);
    if (said.ok()) {
      out << each.name << ": " << EscapeText(*said) << "\n";
    } else {
      all = absl::UnavailableError(absl::StrCat(all.message(), all.ok() ? "" : "\n", each.name,
                                                ": ", said.status().message()));
    }
  }
  return all;
}

}  // namespace
}  // namespace rips::actuator

int main(int argc, char** argv) {
  rips::OpenStandardStreams();
  rips::OutputStream out(STDOUT_FILENO);
  std::string file = "/etc/rips/actuator.yaml";
  std::string device;
  std::string state;
  CLI::App app("Lists and reads the USB alarms of a robot, or sets one.", "rips-alarm");
  app.footer("A running rips-actuator sets its alarms again, and keeps serial boards open.");
  app.add_option("--config", file, "configuration of rips-actuator")->capture_default_str();
  CLI::Option* which = app.add_option("DEVICE", device, "name in `devices`; without: all");
  app.add_option("STATE", state, "state to bring it into; without: look")->needs(which);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return out.End(app.exit(error, out, std::cerr) == 0 ? 0 : rips::kExitConfig);
  }
  rips::SetLogLevel(rips::LogLevel::kError);  // what matters is printed
  const absl::Status status = rips::actuator::Run(file, device, state, out);
  if (status.ok()) return out.End(0);
  std::fprintf(stderr, "%s\n", std::string(status.message()).c_str());
  const bool mistake = absl::IsInvalidArgument(status);
  return out.End(mistake ? rips::kExitConfig : rips::kExitFailed);
}
