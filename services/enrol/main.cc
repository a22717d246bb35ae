// rips-enrol: fetches the certificates of a robot's agents, and renews them.
#include <sys/stat.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <iostream>
#include <string>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "services/base/status_macros.h"
#include "services/enrol/fetch.h"
#include "services/enrol/key_folder.h"
#include "services/enrol/token_text.h"
#include "services/rpc/credentials.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/config_sections.h"
#include "services/runtime/core_dumps.h"
#include "services/runtime/daemon_flags.h"
#include "services/runtime/daemon_log.h"
#include "services/runtime/output_stream.h"
#include "services/text/escape.h"

namespace rips::enrol {
namespace {

constexpr int kDone = 0;
constexpr int kFailed = 1;
constexpr int kUsage = 2;
constexpr const char* kRoles[] = {"sensor", "actuator"};

struct Flags {
  std::string token;
  std::string directory = "/etc/rips/pki";
  std::string server;
  int timeout_seconds = 15;
  bool now = false;
  bool replace_identity = false;
};

std::string UtcText(absl::Time time) {
  return absl::FormatTime("%Y-%m-%d %H:%M UTC", time, absl::UTCTimeZone());
}

int Fail(const absl::Status& status, const std::string& what = "") {
  std::cerr << "error: " << what << (what.empty() ? "" : ": ") << EscapeText(status.message())
            << "\n";
  return kFailed;
}

void PrintGood(const rpc::Peer& peer, const char* done, const KeyFolder& folder,
               OutputStream& out) {
  out << rpc::RoleName(peer.identity.role) << " of " << peer.identity.robot << " on "
      << peer.identity.host << ": " << done << "; certificate until " << UtcText(peer.not_after)
      << " in " << folder.path() << "\n";
}

// Packages of the agents give their folders to the agents' groups.
void WarnOfGroup(const KeyFolder& folder) {
  struct stat info {};
  if (stat(folder.path().c_str(), &info) != 0 || info.st_gid != 0 || info.st_uid != 0) return;
  std::cerr << "warning: " << folder.path()
            << " belongs to root and its group: an agent with a user "
            << "of its own cannot read it; `chgrp -R` it to that user's group\n";
}

absl::StatusOr<v1::EnrolmentToken> ReadToken(const std::string& path) {
  std::string text;
  if (path == "-") {
    std::getline(std::cin, text);
  } else {
    RIPS_ASSIGN_OR_RETURN(text, ReadFile(path, kTokenBytesMax));
  }
  return ParseToken(text);
}

int Fetch(const Flags& flags, OutputStream& out) {
  absl::StatusOr<v1::EnrolmentToken> token = ReadToken(flags.token);
  if (!token.ok()) return Fail(token.status(), flags.token == "-" ? "" : flags.token);
  if (!flags.server.empty()) token->set_server(flags.server);
  int code = kDone;
  for (const std::string& role : token->roles()) {
    const KeyFolder folder(absl::StrCat(flags.directory, "/", role));
    const auto peer = FetchFirst(*token, role, folder, absl::Seconds(flags.timeout_seconds),
                                 flags.replace_identity);
    if (peer.ok()) {
      PrintGood(*peer, "enrolled", folder, out);
      WarnOfGroup(folder);
    } else {
      code = Fail(peer.status(), role);
    }
  }
  return code;
}

int RenewAll(const Flags& flags, OutputStream& out) {
  int code = kDone;
  int found = 0;
  for (const char* role : kRoles) {
    const KeyFolder folder(absl::StrCat(flags.directory, "/", role));
    if (!folder.HasCertificate()) continue;
    ++found;
    const absl::StatusOr<rpc::Peer> present = Present(folder);
    if (!present.ok()) {
      code = Fail(present.status(), role);
      continue;
    }
    if (!flags.now && !IsDue(*present, absl::Now())) {
      PrintGood(*present, "not due yet", folder, out);
      continue;
    }
    const std::string server = flags.server.empty() ? folder.Server() : flags.server;
    if (!IsHostPort(server)) {
      code = Fail(
          absl::FailedPreconditionError(absl::StrCat(
              folder.path(),
              " names no server, so it was not written by rips-enrol; give --server HOST:PORT")),
          role);
      continue;
    }
    const auto peer = Renew(folder, server, absl::Seconds(flags.timeout_seconds));
    if (peer.ok()) {
      PrintGood(*peer, "renewed", folder, out);
    } else {
      code = Fail(peer.status(), role);
    }
  }
  if (found == 0) {
    return Fail(absl::NotFoundError(
        absl::StrCat("no agent of this host has a certificate below ", flags.directory,
                     "; fetch the first with a token: rips-enrol fetch --token FILE")));
  }
  return code;
}

int Main(int argc, char** argv) {
  OpenStandardStreams();
  ForbidCoreDumps();
  rpc::RequireTls13();
  rpc::RouteGrpcLogs();
  rpc::TrustGrpcLockOrder();
  OutputStream out(STDOUT_FILENO);
  Flags flags;
  CLI::App app("Fetches the certificates of a robot's agents from the policy server.",
               "rips-enrol");
  app.set_version_flag("--version", std::string(RipsVersion()));
  app.require_subcommand(1);
  app.footer(
      "Keys are made on this host and do not leave it. Files go to DIR/sensor and DIR/actuator, "
      "for\n"
      "their owner and group. Exit codes: 0 success, 1 failed, 2 usage error.");
  const auto add_common = [&flags](CLI::App* verb) {
    verb->add_option("--dir", flags.directory, "Directory of the agents' folders")
        ->capture_default_str();
    verb->add_option("--server", flags.server, "HOST:PORT, instead of the one that is recorded");
    verb->add_option("--timeout", flags.timeout_seconds, "Seconds for one call")
        ->check(CLI::Range(1, 300))
        ->capture_default_str();
  };
  CLI::App* const fetch = app.add_subcommand(
      "fetch", "Fetch first certificates with a token of `ripsctl enrol create-token`");
  fetch->add_option("--token", flags.token, "File with the token; - reads it from standard input")
      ->required();
  fetch->add_flag("--replace-identity", flags.replace_identity,
                  "Also if this host has the certificate of another robot or host");
  add_common(fetch);
  CLI::App* const renew = app.add_subcommand(
      "renew", "Renew the certificates that are due: when 60 % of their life is over");
  renew->add_flag("--now", flags.now, "Renew them, due or not");
  add_common(renew);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return out.End(app.exit(error, out, std::cerr) == 0 ? kDone : kUsage);
  }
  if (!flags.server.empty() && !IsHostPort(flags.server)) {
    std::cerr << "error: --server is `" << flags.server << "`; write HOST:PORT\n";
    return kUsage;
  }
  return out.End(fetch->parsed() ? Fetch(flags, out) : RenewAll(flags, out));
}

}  // namespace
}  // namespace rips::enrol

int main(int argc, char** argv) { return rips::enrol::Main(argc, argv); }
