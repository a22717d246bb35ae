#include "services/runtime/output_stream.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <iostream>

namespace rips {
namespace {

constexpr size_t kOutputBufferBytes = 64 << 10;
constexpr int kExitNotWritten = 1;

// errno of the write that failed; 0 if all was written.
int WriteToEnd(int fd, const char* bytes, size_t size) {
  while (size > 0) {
    const ssize_t written = write(fd, bytes, size);
    if (written >= 0) {
      bytes += written;
      size -= static_cast<size_t>(written);
    } else if (errno == EAGAIN) {
      pollfd ready = {.fd = fd, .events = POLLOUT, .revents = 0};
      poll(&ready, 1, -1);
    } else if (errno != EINTR) {
      return errno;
    }
  }
  return 0;
}

void OnSigpipe(int) {}

}  // namespace

void HandleSigpipe() {
  struct sigaction action {};
  action.sa_handler = OnSigpipe;  // unlike SIG_IGN not inherited
  action.sa_flags = SA_RESTART;
  sigaction(SIGPIPE, &action, nullptr);
}

OutputStream::Buffer::Buffer(int fd) : fd_(fd), bytes_(kOutputBufferBytes) {
  setp(bytes_.data(), bytes_.data() + bytes_.size());
}

bool OutputStream::Buffer::Write() {
  if (error_ == 0) error_ = WriteToEnd(fd_, pbase(), static_cast<size_t>(pptr() - pbase()));
  setp(bytes_.data(), bytes_.data() + bytes_.size());
  return error_ == 0;
}

OutputStream::Buffer::int_type OutputStream::Buffer::overflow(int_type next) {
  if (!Write()) return traits_type::eof();
  if (!traits_type::eq_int_type(next, traits_type::eof())) sputc(traits_type::to_char_type(next));
  return traits_type::not_eof(next);
}

int OutputStream::Buffer::sync() { return Write() ? 0 : -1; }

void OutputStream::Buffer::CheckClose() {
  if (error_ != 0) return;
  const int copy = fcntl(fd_, F_DUPFD_CLOEXEC, 0);
  if (copy >= 0 && close(copy) != 0 && errno != EINTR) error_ = errno;
}

OutputStream::OutputStream(int fd) : std::ostream(nullptr), buffer_(fd) { rdbuf(&buffer_); }

OutputStream::~OutputStream() { flush(); }

int OutputStream::End(int code) {
  const bool closed = !good() && buffer_.error() == 0;
  flush();
  buffer_.CheckClose();
  if (closed || buffer_.error() == EPIPE) return code == 0 ? kExitReaderGone : code;
  if (buffer_.error() == 0) return code;
  std::cerr << "error: cannot write to standard output: " << std::strerror(buffer_.error())
            << "; the output is not complete\n";
  return code == 0 ? kExitNotWritten : code;
}

}  // namespace rips
