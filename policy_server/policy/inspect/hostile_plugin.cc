// A plugin under somebody else's control: it tries what each payload says, and answers yes if it
// could. For containment_test.cc.
#include <fcntl.h>
#include <netinet/in.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/ptrace.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <sys/un.h>
#include <unistd.h>

#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <sstream>
#include <string>

namespace {

// Descendants are found by this name from outside.
void Rename(const std::string& name) { prctl(PR_SET_NAME, name.c_str()); }

bool CanOpen(const std::string& path, int flags) { return open(path.c_str(), flags, 0644) >= 0; }

bool CanConnect(int family, const sockaddr* address, socklen_t bytes) {
  const int made = socket(family, SOCK_STREAM, 0);
  return made >= 0 && connect(made, address, bytes) == 0;
}

bool CanConnectTcp(int port) {
  sockaddr_in address = {};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  return CanConnect(AF_INET, reinterpret_cast<sockaddr*>(&address), sizeof(address));
}

// `@name` is abstract.
bool CanConnectUnix(const std::string& name) {
  sockaddr_un address = {};
  address.sun_family = AF_UNIX;
  std::memcpy(address.sun_path, name.data(), name.size());
  const bool abstract = name[0] == '@';
  if (abstract) address.sun_path[0] = '\0';
  const size_t bytes = offsetof(sockaddr_un, sun_path) + name.size() + (abstract ? 0 : 1);
  return CanConnect(AF_UNIX, reinterpret_cast<sockaddr*>(&address), static_cast<socklen_t>(bytes));
}

bool CanReadMemory(pid_t pid) {
  char byte;
  iovec here = {.iov_base = &byte, .iov_len = 1};
  iovec there = {.iov_base = &byte, .iov_len = 1};
  return CanOpen("/proc/" + std::to_string(pid) + "/mem", O_RDONLY) ||
         CanOpen("/proc/" + std::to_string(pid) + "/mem", O_RDWR) ||
         syscall(SYS_process_vm_readv, pid, &here, 1, &there, 1, 0) == 1 ||
         ptrace(PTRACE_SEIZE, pid, nullptr, nullptr) == 0;
}

// A process without parent, session or group of ours.
void Escape(const std::string& name) {
  if (fork() != 0) return;
  setsid();
  if (fork() != 0) _exit(0);
  setsid();
  Rename(name);
  signal(SIGTERM, SIG_IGN);
  for (int fd = 0; fd < 3; ++fd) close(fd);
  while (true) pause();
}

// Processes that could be made, of 2,000.
int Bomb(const std::string& name) {
  int made = 0;
  while (made < 2000) {
    const pid_t child = fork();
    if (child < 0) break;
    if (child == 0) {
      Rename(name);
      while (true) pause();
    }
    ++made;
  }
  return made;
}

bool CanTake(size_t bytes) {
  void* taken = mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  return taken != MAP_FAILED;
}

// That of the server has a group and capabilities, too.
bool RunsAs(uid_t uid) {
  gid_t groups[64];
  return getuid() == uid && geteuid() == uid && getgroups(64, groups) == 0 &&
         prctl(PR_CAPBSET_READ, 0) == 0 && prctl(PR_GET_NO_NEW_PRIVS, 0, 0, 0, 0) == 1;
}

bool Try(const std::string& order) {
  std::istringstream words(order);
  std::string what, text;
  words >> what >> text;
  const int number = std::atoi(text.c_str());
  if (what == "read") return CanOpen(text, O_RDONLY);
  if (what == "write") return CanOpen(text, O_RDWR);
  if (what == "make") return CanOpen(text, O_WRONLY | O_CREAT) || mkdir(text.c_str(), 0755) == 0;
  if (what == "remove") return unlink(text.c_str()) == 0;
  if (what == "memory-of") return CanReadMemory(number);
  if (what == "tcp") return CanConnectTcp(number);
  if (what == "unix") return CanConnectUnix(text);
  if (what == "kill") return kill(number, 0) == 0;
  if (what == "limit") {
    const rlimit none = {};
    return prlimit(number, RLIMIT_NOFILE, &none, nullptr) == 0;
  }
  if (what == "as") return RunsAs(static_cast<uid_t>(number));
  if (what == "take") return CanTake(static_cast<size_t>(number) << 20);
  if (what == "bomb") return Bomb(text) > 500;
  if (what == "escape") Escape(text);
  return what == "escape";
}

}  // namespace

int main() {
  std::cout << "rips-plugin 1\n" << std::flush;
  uint32_t size = 0;
  while (std::cin.read(reinterpret_cast<char*>(&size), sizeof(size))) {
    std::string header(size, '\0');
    std::cin.read(header.data(), static_cast<std::streamsize>(size));
    const size_t at = header.find("\"payload_bytes\":");
    std::string payload(std::strtoul(header.c_str() + at + 16, nullptr, 10), '\0');
    std::cin.read(payload.data(), static_cast<std::streamsize>(payload.size()));
    std::cout << (Try(payload) ? "1\n" : "0\n") << std::flush;
  }
}
