// Standard output of a program that prints: what could not be written is not lost in silence.
#ifndef RIPS_SERVICES_RUNTIME_OUTPUT_STREAM_H_
#define RIPS_SERVICES_RUNTIME_OUTPUT_STREAM_H_

#include <ostream>
#include <streambuf>
#include <vector>

namespace rips {

// Exit code after the reader of the output has closed it: as a shell shows a program that SIGPIPE
// ended. Nothing is printed about it.
inline constexpr int kExitReaderGone = 141;

// Makes a write to a pipe without a reader fail with EPIPE, in place of ending the process. A
// program that this one starts does not inherit that.
void HandleSigpipe();

// Writes to a descriptor, which is not owned. After the first error the stream is bad, and writes
// nothing more. One thread at a time.
class OutputStream final : public std::ostream {
 public:
  explicit OutputStream(int fd);
  ~OutputStream() override;

  // Writes what is left. `code`, or if it is 0 and something could not be written, after an error
  // on standard error: 1. A reader that is gone: kExitReaderGone, without a word; also if the
  // stream was made bad by a caller that knows it.
  int End(int code);

 private:
  class Buffer final : public std::streambuf {
   public:
    explicit Buffer(int fd);
    // errno of the first write that failed; 0 = none did.
    int error() const { return error_; }
    // What a file system says only when the file is closed: a remote disk that is full.
    void CheckClose();

   protected:
    int_type overflow(int_type next) override;
    int sync() override;

   private:
    bool Write();

    const int fd_;
    int error_ = 0;
    std::vector<char> bytes_;
  };

  Buffer buffer_;
};

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_OUTPUT_STREAM_H_
