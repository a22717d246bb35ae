#include "policy_server/ripsctl/app.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <sstream>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/commands.h"
#include "services/base/status_macros.h"
#include "services/rpc/bidi_client.h"
#include "services/rpc/credentials.h"
#include "services/runtime/config_reader.h"
#include "services/runtime/config_sections.h"
#include "services/runtime/daemon_flags.h"
#include "services/text/nearest.h"
#include "services/text/utf8.h"

namespace rips::ripsctl {
namespace {

struct Noun {
  const char* name;
  const char* synopsis;
  bool hidden = false;  // not in --help: for who builds packages
};

constexpr Noun kNouns[] = {
    {"robot", "List robots and show their state, ROS graph and coverage"},
    {"top", "Show the most urgent robots on the whole terminal, live"},
    {"level", "Show, raise and lower alert levels"},
    {"alert", "List, watch and acknowledge alerts, and fetch what led to them"},
    {"explain", "Explain an alert, or why a robot is at its level"},
    {"rules", "Check, test, sign and replay rules; bring them into force on robots"},
    {"audit", "Verify and read a policy server's audit log; needs no server"},
    {"agent", "List certificates; ban and unban agents and operators"},
    {"enrol", "Make tokens with which robots fetch their certificates; list what was issued"},
    {"signal", "Send a signal for a robot's rules to judge"},
    {"record", "Record the events a robot's rules are evaluated on"},
    {"context", "List the contexts of the settings file; change the current one"},
    {"completion", "Print the completion of commands for a shell"},
    {"man", "Print ripsctl(1), the manual page, in roff", /*hidden=*/true},
};
// In the order in which --help lists the verbs of a noun.
constexpr Commands (*kMakers[])() = {
    RobotCommands,   ConfigCommands, CoverageCommands, ActuatorCommands, MaintenanceCommands,
    TopCommand,      LevelCommands,  ApproveCommands,  AlertCommands,    AlertRecordingCommands,
    ExplainCommands, CheckRules,     FormatRules,      RulesBuiltins,    TestRules,
    ReplayRules,     SignRules,      PushRules,        ActivateRules,    RulesStatus,
    ShadowRules,     ResumeRules,    AuditCommands,    AgentCommands,    EnrolCommands,
    SignalCommands,  RecordCommands, ContextCommands,  ReferenceCommands};

// The whole command line.
class Parser {
 public:
  Parser()
      : app_(
            "Watch and control robots guarded by a RIPS policy server.\n"
            "A robot was stopped? `ripsctl robot list`, `ripsctl explain ROBOT`, and what that "
            "says.",
            "ripsctl") {
    app_.require_subcommand(1);
    app_.fallthrough();
    app_.set_version_flag("--version", std::string(RipsVersion()));
    app_.add_option("--context", flags_.context, "Context of the settings file to use")
        ->type_name("CONTEXT");
    app_.add_option("--server", flags_.server, "HOST:PORT of the policy server");
    app_.add_option("--cert", flags_.cert, "Certificate to connect with, a PEM file");
    app_.add_option("--key", flags_.key, "Private key of --cert, a PEM file");
    app_.add_option("--ca", flags_.ca, "Certificate authority to trust, a PEM file");
    app_.add_option("--output", flags_.output, "text, or json for programs")
        ->type_name("text|json");
    app_.add_option("--timeout", flags_.timeout, "Time limit of one call, for example 10s");
    app_.footer(
        "Settings (--server, --cert, --key, --ca, --output, --timeout) come from flags, then\n"
        "RIPSCTL_SERVER, RIPSCTL_CERT, ..., then ~/.config/rips/ripsctl.yaml: the context that\n"
        "--context, RIPSCTL_CONTEXT or its key `current` names, then its top.\n"
        "Exit codes:" +
        absl::StrJoin(kExitCodes, ",",
                      [](std::string* out, const ExitCodeMeaning& each) {
                        const bool second_line = each.code == ExitCode::kUsage;
                        absl::StrAppend(out, second_line ? "\n" : " ", static_cast<int>(each.code),
                                        " ", each.meaning);
                      }) +
        ".");
    for (const Noun& noun : kNouns) {
      CLI::App* const app = app_.add_subcommand(noun.name, noun.synopsis)->fallthrough();
      if (noun.hidden) app->group("");
    }
    for (const auto maker : kMakers) {
      for (std::unique_ptr<Command>& command : maker()) Add(std::move(command));
    }
  }

  // The chosen command; nullptr after printing why there is none, with the code to exit with.
  Command* Parse(std::vector<std::string> args, const World& world, int* exit_code) {
    if (const std::string wrong = UnknownVerb(args); !wrong.empty()) {
      TextStream(world.err) << "error: " << wrong << "\n";
      *exit_code = static_cast<int>(ExitCode::kUsage);
      return nullptr;
    }
    const std::string garbled = NotUtf8(args);
    std::reverse(args.begin(), args.end());  // as CLI11 wants them
    try {
      app_.parse(args);
    } catch (const CLI::ParseError& error) {
      // Help, or an error that repeats an argument.
      std::ostringstream out;
      std::ostringstream err;
      const int code = app_.exit(error, out, err);
      TextStream(world.out) << Lines{out.str()};
      TextStream(world.err) << Lines{err.str()};
      *exit_code = static_cast<int>(code == 0 ? ExitCode::kDone : ExitCode::kUsage);
      return nullptr;
    }
    if (!garbled.empty() && chosen_->info().needs_server) {
      TextStream(world.err) << "error: argument `" << garbled
                            << "` is not UTF-8; the server takes no other "
                            << "text, so use a terminal whose locale is UTF-8\n";
      *exit_code = static_cast<int>(ExitCode::kUsage);
      return nullptr;
    }
    return chosen_;
  }

  const RawSettings& flags() const { return flags_; }

 private:
  // The first such argument, escaped; empty if there is none.
  static std::string NotUtf8(const std::vector<std::string>& args) {
    for (const std::string& each : args) {
      if (FindInvalidUtf8(each).has_value()) return EscapeText(each);
    }
    return "";
  }
  // What is wrong with `NOUN VERB`; empty if nothing is, or if CLI11 says it better.
  std::string UnknownVerb(const std::vector<std::string>& args) const {
    if (args.size() < 2 || args[1].empty() || args[1][0] == '-') return "";
    std::vector<absl::string_view> verbs;
    for (const std::unique_ptr<Command>& command : commands_) {
      const Command::Info& info = command->info();
      if (info.noun != args[0]) continue;
      if (info.verb.empty() || info.verb == args[1]) return "";
      verbs.push_back(info.verb);
    }
    if (verbs.empty()) return "";
    const std::string hint = NearestHint(args[1], verbs);
    return absl::StrCat("`", args[0], "` has no `", EscapeText(args[1]), "`; ",
                        hint.empty() ? absl::StrCat("it has ", absl::StrJoin(verbs, ", ")) : hint);
  }

  void Add(std::unique_ptr<Command> command) {
    const Command::Info& info = command->info();
    CLI::App* app = app_.get_subcommand(info.noun);
    if (!info.verb.empty()) {
      app->require_subcommand(1);
      app = app->add_subcommand(info.verb, info.synopsis);
      app->fallthrough();
    }
    command->AddFlags(*app);
    app->callback([this, chosen = command.get()] { chosen_ = chosen; });
    commands_.push_back(std::move(command));
  }

  CLI::App app_;
  RawSettings flags_;
  Commands commands_;
  Command* chosen_ = nullptr;  // Into commands_.
};

absl::StatusOr<SettingsFile> ReadSettingsFile(const std::string& path) {
  if (path.empty()) return SettingsFile{};
  const absl::StatusOr<std::string> text = ReadConfigFile(path);
  if (absl::IsNotFound(text.status())) return SettingsFile{};
  RIPS_RETURN_IF_ERROR(text.status());
  return ParseSettings(path, *text);
}

// Fills what `env` has of settings.
absl::Status ReadSettings(RawSettings flags, SettingsUse uses, const World& world, Env* env) {
  const GetEnv none = [](const std::string&) { return std::nullopt; };
  const GetEnv& get_env = uses == SettingsUse::kNothing ? none : world.get_env;
  env->settings_path = SettingsPath(get_env);
  RIPS_ASSIGN_OR_RETURN(env->settings_file, ReadSettingsFile(env->settings_path));
  if (uses == SettingsUse::kAll) {
    RIPS_ASSIGN_OR_RETURN(flags.context, ChooseContext(flags, get_env, env->settings_file));
  }
  env->settings = Merge(std::move(flags), get_env, env->settings_file);
  return absl::OkStatus();
}

// Checks what does not need a connection.
absl::Status Apply(const RawSettings& settings, const Command& command, Env* env) {
  if (settings.output == "junit" && command.info().writes_junit) {
    env->output = Output::kJunit;
  } else if (settings.output == "text" || settings.output == "json") {
    env->output = settings.output == "json" ? Output::kJson : Output::kText;
  } else {
    return absl::InvalidArgumentError(absl::StrCat("--output is `", settings.output,
                                                   command.info().writes_junit
                                                       ? "`; write `text`, `json` or `junit`"
                                                       : "`; write `text` or `json`"));
  }
  RIPS_ASSIGN_OR_RETURN(env->timeout, ParseConfigDuration(settings.timeout));
  if (env->timeout <= absl::ZeroDuration()) {
    return absl::InvalidArgumentError("--timeout must be longer than 0s");
  }
  if (!IsHostPort(settings.server)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "--server is `", settings.server, "`; write HOST:PORT, for example policy.example:7443"));
  }
  return absl::OkStatus();
}

ExitCode RunCommand(Command& command, const RawSettings& flags, const World& world) {
  Env env{.out = world.out, .err = world.err};
  env.in = world.in;
  env.sleep = world.sleep;
  env.terminal = world.terminal;
  env.out_fd = world.out_fd;
  absl::Status status = ReadSettings(flags, command.info().uses, world, &env);
  if (status.ok()) status = Apply(env.settings, command, &env);
  if (status.ok()) status = command.Check();
  if (!status.ok()) return UsageError(env, status.message());
  std::unique_ptr<v1::OperatorService::StubInterface> stub;
  if (command.info().needs_server) {
    auto connected = world.connect(env.settings);
    if (!connected.ok()) return UsageError(env, connected.status().message());
    stub = *std::move(connected);
    env.server = stub.get();
  }
  const absl::StatusOr<ExitCode> code = command.Run(env);
  return code.ok() ? *code : Failed(env, code.status());
}

}  // namespace

absl::StatusOr<std::unique_ptr<v1::OperatorService::StubInterface>> ConnectWithTls(
    const RawSettings& settings) {
  const std::pair<const char*, const std::string*> needed[] = {
      {"ca", &settings.ca}, {"cert", &settings.cert}, {"key", &settings.key}};
  for (const auto& [name, value] : needed) {
    if (!value->empty()) continue;
    return absl::InvalidArgumentError(
        absl::StrCat("--", name,
                     " is missing; give --ca, --cert and --key, or put them into "
                     "~/.config/rips/ripsctl.yaml"));
  }
  RIPS_ASSIGN_OR_RETURN(
      const auto credentials,
      rpc::Credentials::Load({.ca = settings.ca, .cert = settings.cert, .key = settings.key}));
  return v1::OperatorService::NewStub(rpc::MakeChannel(settings.server, credentials->ForClient()));
}

int RunRipsctl(const std::vector<std::string>& args, const World& world) {
  Parser parser;
  int exit_code = 0;
  Command* command = parser.Parse(args, world, &exit_code);
  if (command == nullptr) return exit_code;
  return static_cast<int>(RunCommand(*command, parser.flags(), world));
}

}  // namespace rips::ripsctl
