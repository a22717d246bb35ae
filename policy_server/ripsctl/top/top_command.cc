// `ripsctl top`: the fleet on the whole terminal.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "policy_server/ripsctl/commands.h"
#include "policy_server/ripsctl/top/fleet_view.h"
#include "policy_server/ripsctl/top/fleet_watch.h"
#include "policy_server/ripsctl/top/terminal.h"
#include "services/base/status_macros.h"

namespace rips::ripsctl {
namespace {

// Between two drawings: of news at least, and of the clock alone.
constexpr absl::Duration kDrawMin = absl::Milliseconds(500);
constexpr absl::Duration kDrawMax = absl::Seconds(1);

// Of a clock that is never set.
absl::Duration Uptime() {
  return absl::FromChrono(std::chrono::steady_clock::now().time_since_epoch());
}

class Top final : public Command {
 public:
  Top()
      : Command({"top", "",
                 "Show the most urgent robots on the whole terminal, live; q or Ctrl-C ends it"}) {}
  void AddFlags(CLI::App& app) override {
    app.add_option("ROBOT", robots_, "Robot ids; default: all");
  }
  absl::Status Check() override {
    for (const std::string& robot : robots_) RIPS_RETURN_IF_ERROR(CheckRobot(robot));
    return absl::OkStatus();
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    if (env.json()) {
      return UsageError(env, "top shows a screen, not JSON; use `ripsctl robot watch`");
    }
    absl::StatusOr<std::unique_ptr<Terminal>> terminal = Terminal::Open(env.terminal);
    if (absl::IsFailedPrecondition(terminal.status())) {
      return UsageError(env, absl::StrCat(terminal.status().message(),
                                          "; `ripsctl robot watch` prints each change as a line"));
    }
    RIPS_RETURN_IF_ERROR(terminal.status());
    const absl::Status status = Show(env, **terminal);
    terminal->reset();  // before an error is printed
    RIPS_RETURN_IF_ERROR(status);
    return ExitCode::kDone;
  }

 private:
  // Until the operator or the watch ends it.
  absl::Status Show(Env& env, Terminal& terminal) const {
    FleetWatch watch(&env, robots_);
    absl::Duration drawn = -absl::InfiniteDuration();
    bool news = true;
    while (true) {
      if (const std::optional<absl::Status> end = watch.ended(); end.has_value()) return *end;
      if (Uptime() >= drawn + (news ? kDrawMin : kDrawMax)) {
        watch.changed().Drain();
        const auto lines = watch.Render(terminal.size(), absl::Now());
        RIPS_RETURN_IF_ERROR(terminal.Write(ScreenBytes(lines)));
        drawn = Uptime();
        news = false;
      }
      switch (terminal.Wait(news ? -1 : watch.changed().get(),
                            drawn + (news ? kDrawMin : kDrawMax) - Uptime())) {
        case Terminal::Wake::kTimeout:
          break;
        case Terminal::Wake::kOther:
          news = true;
          break;
        case Terminal::Wake::kEnd:
          return absl::OkStatus();
      }
    }
  }

  std::vector<std::string> robots_;
};

}  // namespace

Commands TopCommand() { return MakeCommands<Top>(); }

}  // namespace rips::ripsctl
