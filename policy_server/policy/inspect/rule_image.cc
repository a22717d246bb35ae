#include "policy_server/policy/inspect/rule_image.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <string>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/inspect/jail_spec.h"
#include "services/base/status_macros.h"

namespace rips::inspect {
namespace {

template <typename T>
void AppendNumber(const T& value, std::string& to) {
  to.append(reinterpret_cast<const char*>(&value), sizeof(value));
}

absl::Status WriteAll(int fd, absl::string_view rest) {
  while (!rest.empty()) {
    const ssize_t wrote = write(fd, rest.data(), rest.size());
    if (wrote > 0) rest.remove_prefix(static_cast<size_t>(wrote));
    if (wrote < 0 && errno != EINTR) {
      return absl::UnavailableError(
          absl::StrCat("no memory for compiled YARA files: ", std::strerror(errno)));
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<std::shared_ptr<const RuleImage>> RuleImage::Create(
    const std::vector<std::shared_ptr<const YaraRules>>& files) {
  std::string head;
  AppendNumber(RuleImageHeader{.count = files.size()}, head);
  std::string body;
  for (const auto& file : files) {
    RIPS_ASSIGN_OR_RETURN(const std::string compiled, file->Serialize());
    AppendNumber(uint64_t{compiled.size()}, head);
    body += compiled;
  }
  UniqueFd memory(memfd_create("rips-yara-rules", MFD_CLOEXEC | MFD_ALLOW_SEALING));
  if (memory.get() < 0) {
    return absl::UnavailableError(
        absl::StrCat("no memory for compiled YARA files: ", std::strerror(errno)));
  }
  RIPS_RETURN_IF_ERROR(WriteAll(memory.get(), head));
  RIPS_RETURN_IF_ERROR(WriteAll(memory.get(), body));
  fcntl(memory.get(), F_ADD_SEALS, F_SEAL_WRITE | F_SEAL_GROW | F_SEAL_SHRINK | F_SEAL_SEAL);
  return std::shared_ptr<const RuleImage>(new RuleImage(std::move(memory)));
}

}  // namespace rips::inspect
