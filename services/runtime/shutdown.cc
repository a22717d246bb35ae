#include "services/runtime/shutdown.h"

#include <poll.h>
#include <signal.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include <cerrno>
#include <utility>

#include "services/base/check.h"

namespace rips {
namespace {

sigset_t HandledSignals() {
  sigset_t set;
  sigemptyset(&set);
  for (const int signal : {SIGTERM, SIGINT, SIGHUP, SIGUSR1, SIGUSR2}) sigaddset(&set, signal);
  return set;
}

}  // namespace

void BlockSignals() {
  const sigset_t set = HandledSignals();
  RIPS_CHECK(pthread_sigmask(SIG_BLOCK, &set, nullptr) == 0, "pthread_sigmask");
  signal(SIGPIPE, SIG_IGN);
}

SignalWaiter::SignalWaiter(Callbacks callbacks) : callbacks_(std::move(callbacks)) {
  const sigset_t set = HandledSignals();
  signal_fd_ = UniqueFd(signalfd(-1, &set, SFD_CLOEXEC | SFD_NONBLOCK));
  RIPS_CHECK(signal_fd_.get() >= 0, "no file descriptor for signals");
  thread_ = std::thread([this] { Run(); });
}

SignalWaiter::~SignalWaiter() {
  stop_.Wake();
  thread_.join();
}

int SignalWaiter::WaitForShutdown() {
  MutexLock lock(&mu_);
  while (!ended_) ended_cond_.Wait(lock);
  return signal_;
}

bool SignalWaiter::WaitForShutdown(absl::Duration timeout) {
  MutexLock lock(&mu_);
  while (!ended_ && ended_cond_.WaitFor(lock, timeout)) {
  }
  return ended_;
}

void SignalWaiter::EndWait(int signal) {
  MutexLock lock(&mu_);
  if (ended_) return;
  ended_ = true;
  signal_ = signal;
  ended_cond_.NotifyAll();
}

void SignalWaiter::Run() {
  while (true) {
    pollfd fds[] = {{signal_fd_.get(), POLLIN, 0}, {stop_.get(), POLLIN, 0}};
    if (poll(fds, 2, -1) < 0) {
      RIPS_CHECK(errno == EINTR, "poll");
      continue;
    }
    if (fds[1].revents != 0) return;
    signalfd_siginfo info{};
    if (read(signal_fd_.get(), &info, sizeof info) != sizeof info) continue;
    const int signal = static_cast<int>(info.ssi_signo);
    if (const auto found = callbacks_.find(signal); found != callbacks_.end()) found->second();
    if (signal == SIGTERM || signal == SIGINT) EndWait(signal);
  }
}

}  // namespace rips
