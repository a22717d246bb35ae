#include "policy_server/policy/inspect/jail_spec.h"

#include <fcntl.h>
#include <unistd.h>

#include <charconv>
#include <cstdio>

#include "policy_server/policy/inspect/confine.h"

namespace rips::inspect {
namespace {

constexpr int kExitUsage = 2;

template <typename T>
bool ReadNumber(const std::string& word, T* number) {
  const char* end = word.data() + word.size();
  const auto [stopped, error] = std::from_chars(word.data(), end, *number);
  return error == std::errc() && stopped == end;
}

}  // namespace

bool ParseJailSpec(const std::vector<std::string>& words, JailSpec* spec) {
  constexpr size_t kFixed = 6;
  if (words.size() < kFixed + 1) return false;
  spec->mode = words[0];
  if (words[1] != "-") {
    JailIds ids;
    if (!ReadNumber(words[1], &ids.uid) || !ReadNumber(words[2], &ids.gid)) return false;
    spec->ids = ids;
  }
  if (!ReadNumber(words[3], &spec->address_space_bytes) ||
      !ReadNumber(words[4], &spec->open_files) || !ReadNumber(words[5], &spec->tasks)) {
    return false;
  }
  size_t at = kFixed;
  while (at < words.size() && words[at] != "--") spec->readable.push_back(words[at++]);
  if (at == words.size()) return false;
  const size_t programs = words.size() - at - 1;
  if (programs == 1) spec->program = words[at + 1];
  return spec->mode == "plugin" ? programs == 1
                                : programs == 0 && (spec->mode == "probe" || spec->mode == "yara");
}

void BeginJail(int argc, char** argv, JailSpec* spec) {
  const std::vector<std::string> words(argv + 1, argv + argc);
  if (!ParseJailSpec(words, spec) || fcntl(kReportFd, F_GETFD) < 0) {
    std::fprintf(stderr, "%s is started by rips-policy-server and ripsctl, not by hand.\n",
                 argv[0]);
    _exit(kExitUsage);
  }
  for (const int fd : {kReportFd, kCgroupFd}) fcntl(fd, F_SETFD, FD_CLOEXEC);
  // `0` is whoever writes it; /dev/null takes it too.
  if (write(kCgroupFd, "0", 1) != 1) FailJail("cannot enter its cgroup");
  close(kCgroupFd);
}

}  // namespace rips::inspect
