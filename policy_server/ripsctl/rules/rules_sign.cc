// `ripsctl rules sign`: signs a bundle for a server that trusts the key's public half; writes
// DIR/signature (policy_server/policy/bundle/bundle_signature.h). kRefused for a bundle that has
// errors; kUsage for a key file that is not one private Ed25519 key, or that other users may read.
// JSON: {"name","id","key_id","signature":path}.
#include <errno.h>
#include <sys/stat.h>

#include <CLI/CLI.hpp>
#include <cstring>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/policy/bundle/bundle_signature.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/commands.h"
#include "services/base/status_macros.h"
#include "services/runtime/atomic_file.h"

namespace rips::ripsctl {
namespace {

constexpr mode_t kOthers = 077;
// The server runs as another user than the author.
constexpr mode_t kSignatureMode = 0644;

absl::StatusOr<std::string> ReadPrivateKey(const std::string& path) {
  struct stat info = {};
  if (stat(path.c_str(), &info) != 0) {
    return absl::InvalidArgumentError(absl::StrCat("`", path, "`: ", std::strerror(errno)));
  }
  absl::StatusOr<std::string> pem = ReadFile(path, bundle::kKeyFileBytesMax);
  if (!pem.ok()) return pem;
  if (absl::StrContains(*pem, "BEGIN PUBLIC KEY")) {
    return absl::InvalidArgumentError(absl::StrCat(
        "`", path,
        "` is a public key; a bundle is signed with the private one that it belongs to"));
  }
  if (S_ISREG(info.st_mode) && (info.st_mode & kOthers) != 0) {
    return absl::InvalidArgumentError(
        absl::StrFormat("private key `%s` is open to other users (mode %04o); run `chmod 600 %s`, "
                        "and replace the key if one of them may have read it",
                        path, info.st_mode & 07777, path));
  }
  return pem;
}

class SignRulesCommand final : public Command {
 public:
  SignRulesCommand()
      : Command({"rules", "sign", "Check a bundle and sign it; needs no server",
                 /*needs_server=*/false}) {}
  void AddFlags(CLI::App& app) override {
    app.add_option("DIR", dir_, "Directory of the bundle")->required();
    app.add_option("--key", key_, "Private Ed25519 key to sign with, a PEM file")->required();
  }

  absl::StatusOr<ExitCode> Run(Env& env) override {
    const absl::StatusOr<std::string> pem = ReadPrivateKey(key_);
    if (!pem.ok()) return UsageError(env, pem.status().message());
    const bundle::BundleCheck check = bundle::CheckBundle(dir_);
    if (!check.ok()) {
      return absl::FailedPreconditionError(absl::StrCat(
          "`", dir_, "` is not signed, as a server would refuse it; `ripsctl rules check ", dir_,
          "` shows why"));
    }
    const absl::StatusOr<std::string> signature = bundle::SignBundle(check.id, *pem);
    if (!signature.ok()) {
      return UsageError(env, absl::StrCat("`", key_, "`: ", signature.status().message()));
    }
    const std::string path = absl::StrCat(dir_, "/", bundle::kSignatureName);
    const absl::Status written = WriteFileAtomically(path, *signature, kSignatureMode);
    RIPS_RETURN_IF_ERROR(FileError(written));
    Print(env, check, *signature, path);
    return ExitCode::kDone;
  }

 private:
  void Print(Env& env, const bundle::BundleCheck& check, const std::string& signature,
             const std::string& path) const {
    const std::vector<std::string> words = absl::StrSplit(signature, ' ');
    const std::string& key_id = words[1];
    if (env.json()) {
      PrintJson({{"name", check.name}, {"id", check.id}, {"key_id", key_id}, {"signature", path}},
                env.out);
      return;
    }
    env.out << "signed " << check.id << " with key " << key_id << "\n"
            << "public key for the server: openssl pkey -in " << EscapeText(key_)
            << " -pubout -out NAME.pem\n";
  }

  std::string dir_;
  std::string key_;
};

}  // namespace

Commands SignRules() { return MakeCommands<SignRulesCommand>(); }

}  // namespace rips::ripsctl
