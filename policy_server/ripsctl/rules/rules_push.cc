// `ripsctl rules push` and `ripsctl rules list`: bundles on their way to the server, and those that
// it keeps. JSON of `push`: that of `rules check DIR`, and "id","name","signed_by","known",
// "warnings" as the server has it; only "id", null, if the bundle is refused here. Of `list`:
// {"bundles":[{"id","name","signed_by","stored","robots":[..],"problem"}]}, newest first.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/policy/bundle/bundle_archive.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/commands.h"
#include "policy_server/ripsctl/rules/bundle_report.h"
#include "policy_server/ripsctl/rules/rollout_text.h"
#include "services/base/status_macros.h"

namespace rips::ripsctl {
namespace {

constexpr size_t kPieceBytes = size_t{256} << 10;
// How long the server waits for all pieces. --timeout is for its answer.
constexpr absl::Duration kUploadMax = absl::Seconds(120);
constexpr size_t kRobotsShown = 3;

// Sends the archive in pieces.
absl::StatusOr<v1::PushBundleResponse> Send(Env& env, const std::string& archive) {
  env.timeout += kUploadMax;
  grpc::ClientContext context;
  context.set_deadline(absl::ToChronoTime(absl::Now() + env.timeout));
  v1::PushBundleResponse response;
  const auto writer = env.server->PushBundle(&context, &response);
  v1::PushBundleRequest piece;
  piece.set_archive_bytes(archive.size());
  bool open = true;
  for (size_t at = 0; open && at < archive.size(); at += kPieceBytes) {
    piece.set_data(archive.substr(at, kPieceBytes));
    open = writer->Write(piece);
  }
  if (open) writer->WritesDone();
  // If the server does not read on, it has said why.
  if (const grpc::Status status = writer->Finish(); !status.ok()) return rpc::FromGrpc(status);
  return response;
}

class PushRulesCommand final : public Command {
 public:
  PushRulesCommand()
      : Command({"rules", "push", "Check a bundle and store it on the server, for no robot yet"}) {}
  void AddFlags(CLI::App& app) override {
    app.add_option("DIR", dir_, "Directory of the bundle")->required();
  }

  absl::StatusOr<ExitCode> Run(Env& env) override {
    const bundle::BundleCheck check = bundle::CheckBundle(dir_);
    if (!env.json()) PrintBundleCheck(check, env.out);
    if (!check.ok()) {
      if (env.json()) PrintResult(env, check, Json::object({{"id", nullptr}}));
      env.err << "error: the bundle is refused; nothing was sent\n";
      return ExitCode::kRefused;
    }
    RIPS_ASSIGN_OR_RETURN(const std::string archive, bundle::PackBundle(dir_));
    RIPS_ASSIGN_OR_RETURN(const v1::PushBundleResponse pushed, Send(env, archive));
    if (env.json()) {
      PrintResult(env, check, PushedJson(pushed));
    } else {
      Print(env, check, pushed);
    }
    return ExitCode::kDone;
  }

 private:
  static void PrintResult(Env& env, const bundle::BundleCheck& check, const Json& pushed) {
    Json json = BundleCheckJson(check);
    json.update(pushed);
    PrintJson(json, env.out);
  }
  static Json PushedJson(const v1::PushBundleResponse& pushed) {
    return {{"id", pushed.id()},
            {"name", pushed.name()},
            {"signed_by", pushed.signed_by()},
            {"known", pushed.known()},
            {"warnings", pushed.warnings()}};
  }
  static void Print(Env& env, const bundle::BundleCheck& check,
                    const v1::PushBundleResponse& pushed) {
    // The same as above, unless the server is of another version.
    if (check.diagnostics.empty()) {
      for (const absl::string_view line :
           absl::StrSplit(pushed.warnings(), '\n', absl::SkipWhitespace())) {
        env.out << "warning: " << EscapeText(line) << "\n";
      }
    }
    Table table({pushed.known() ? "had already" : "pushed", EscapeText(pushed.name())});
    table.Add({"id", pushed.id()});
    table.Add({"signed by", pushed.signed_by().empty()
                                ? "not checked: the server demands no signature (bundles.keys)"
                                : pushed.signed_by()});
    table.Print(env.out);
    env.out << "it judges no robot yet; to roll it out: ripsctl rules activate "
            << ShellWord(ShortBundle(pushed.id()))
            << " --all --stage 10% --stage 100% --reason TEXT\n";
  }

  std::string dir_;
};

class ListBundlesCommand final : public Command {
 public:
  ListBundlesCommand()
      : Command({"rules", "list", "List the bundles that the server keeps, newest first"}) {}

  absl::StatusOr<ExitCode> Run(Env& env) override {
    RIPS_ASSIGN_OR_RETURN(const auto response,
                          Call(env, &Stub::ListBundles, v1::ListBundlesRequest()));
    if (env.json()) return PrintJson(env, {{"bundles", JsonList(response.bundles(), BundleJson)}});
    if (response.bundles().empty()) {
      env.out << "the server keeps no bundle; `ripsctl rules push DIR` brings one\n";
      return ExitCode::kDone;
    }
    std::vector<std::string> ids;
    for (const v1::StoredBundle& each : response.bundles()) ids.push_back(each.id());
    ids = ShortBundles(ids);
    Table table({"ID", "NAME", "SIGNED BY", "STORED", "ROBOTS"});
    for (int i = 0; i < response.bundles_size(); ++i) {
      const v1::StoredBundle& each = response.bundles(i);
      table.Add({ids[static_cast<size_t>(i)], each.name(), each.signed_by(),
                 ShortTime(each.stored_unix_ns()), RobotsText(each)});
    }
    table.Print(env.out);
    for (int i = 0; i < response.bundles_size(); ++i) {
      const std::string& problem = response.bundles(i).problem();
      if (problem.empty()) continue;
      env.out << EscapeText(ids[static_cast<size_t>(i)])
              << " cannot be activated: " << EscapeText(problem) << "\n";
    }
    return ExitCode::kDone;
  }

 private:
  // `4: r1, r2, r3 and 1 more`.
  static std::string RobotsText(const v1::StoredBundle& bundle) {
    if (bundle.robots().empty()) return "";
    return absl::StrCat(bundle.robots_size(), ": ", NamedRobots(bundle.robots(), kRobotsShown));
  }
  static Json BundleJson(const v1::StoredBundle& bundle) {
    return {{"id", bundle.id()},
            {"name", bundle.name()},
            {"signed_by", bundle.signed_by()},
            {"stored", FullTime(bundle.stored_unix_ns())},
            {"robots", JsonList(bundle.robots())},
            {"problem", bundle.problem()}};
  }
};

}  // namespace

Commands PushRules() { return MakeCommands<PushRulesCommand, ListBundlesCommand>(); }

}  // namespace rips::ripsctl
