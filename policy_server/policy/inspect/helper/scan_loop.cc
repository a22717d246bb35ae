#include "policy_server/policy/inspect/helper/scan_loop.h"

#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"
#include "policy_server/policy/inspect/confine.h"
#include "policy_server/policy/inspect/helper/landlock.h"
#include "policy_server/policy/inspect/helper/seccomp_filter.h"
#include "policy_server/policy/inspect/yara_rules.h"
#include "policy_server/policy/inspect/yara_scanner.h"

namespace rips::inspect {
namespace {

using engine::Verdict;

constexpr int kExitMalformed = 2;

absl::string_view Map(int fd) {
  struct stat info = {};
  if (fstat(fd, &info) != 0 || info.st_size <= 0) FailJail("has nothing to map");
  const auto bytes = static_cast<size_t>(info.st_size);
  void* mapped = mmap(nullptr, bytes, PROT_READ, MAP_SHARED, fd, 0);
  if (mapped == MAP_FAILED) FailJailWithErrno("cannot map");
  return {static_cast<const char*>(mapped), bytes};
}

template <typename T>
T TakeNumber(absl::string_view& rest) {
  T value;
  if (rest.size() < sizeof(value)) FailJail("the rules are cut");
  std::memcpy(&value, rest.data(), sizeof(value));
  rest.remove_prefix(sizeof(value));
  return value;
}

struct Loaded {
  std::shared_ptr<const YaraRules> rules;
  std::unique_ptr<YaraScanner> scanner;
};

std::vector<Loaded> LoadImage(absl::string_view image) {
  const uint64_t count = TakeNumber<RuleImageHeader>(image).count;
  std::vector<uint64_t> sizes;
  for (uint64_t i = 0; i < count; ++i) sizes.push_back(TakeNumber<uint64_t>(image));
  std::vector<Loaded> loaded;
  for (const uint64_t size : sizes) {
    if (image.size() < size) FailJail("the rules are cut");
    const auto rules = YaraRules::Load(image.substr(0, size));
    if (!rules.ok()) FailJail(std::string(rules.status().message()));
    image.remove_prefix(size);
    loaded.push_back({*rules, std::make_unique<YaraScanner>(**rules)});
  }
  return loaded;
}

// False at the end.
bool Receive(ScanQuestion& question) {
  auto* at = reinterpret_cast<char*>(&question);
  size_t have = 0;
  while (have < sizeof(question)) {
    const ssize_t got = read(STDIN_FILENO, at + have, sizeof(question) - have);
    if (got == 0) return false;
    if (got < 0 && errno != EINTR) return false;
    if (got > 0) have += static_cast<size_t>(got);
  }
  return true;
}

char Letter(Verdict verdict) {
  switch (verdict) {
    case Verdict::kYes:
      return '1';
    case Verdict::kNo:
      return '0';
    case Verdict::kUnscanned:
      break;
  }
  return '?';
}

}  // namespace

void RunScanner(const JailSpec& spec) {
  // Before anything hostile can be seen; it may read what the filter below refuses.
  if (const absl::Status ready = YaraRules::Prepare(); !ready.ok())
    FailJail(std::string(ready.message()));
  DropRights(spec, geteuid() == 0);
  prctl(PR_SET_PDEATHSIG, SIGKILL);  // changing the user has undone it
  ForbidNewRights();
  if (const std::string missing = ApplyLandlock({}, {}); !missing.empty()) ReportMissing(missing);
  ApplyLimits(spec, /*limit_tasks=*/false);
  if (const int error = ApplySeccomp(SeccompProfile::kScanner); error != 0) {
    FailJail(std::string("cannot filter its system calls: ") + std::strerror(error));
  }
  const absl::string_view payload = Map(kPayloadFd);
  std::vector<Loaded> loaded = LoadImage(Map(kRulesFd));
  close(kReportFd);

  ScanQuestion question;
  while (Receive(question)) {
    if (question.rules >= loaded.size() || question.bytes > payload.size()) _exit(kExitMalformed);
    const Verdict verdict = loaded[question.rules].scanner->Scan(
        payload.substr(0, question.bytes), absl::Nanoseconds(question.timeout_ns));
    const char letter = Letter(verdict);
    if (write(STDOUT_FILENO, &letter, 1) != 1) break;
  }
  _exit(0);
}

}  // namespace rips::inspect
