// Where commands print. Text that is not written in the source is escaped, so that a command cannot
// forget it: a server, a file or an argument may hold what steers a terminal.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_CLI_TEXT_STREAM_H_
#define RIPS_POLICY_SERVER_RIPSCTL_CLI_TEXT_STREAM_H_

#include <concepts>
#include <ostream>
#include <type_traits>

#include "absl/strings/string_view.h"

namespace rips::ripsctl {

// Text of several lines, such as a part of a file: line ends and tabs stay, all else is escaped.
struct Lines {
  absl::string_view text;
};

// A reference to a stream, to be passed by value. One thread at a time.
class TextStream {
 public:
  TextStream(std::ostream& out) : out_(&out) {}  // NOLINT: each stream may be one

  // As EscapeText gives it, on one line.
  const TextStream& operator<<(absl::string_view text) const;
  const TextStream& operator<<(Lines lines) const;
  // As it stands in the source: write no c_str() here.
  const TextStream& operator<<(const char* source) const {
    *out_ << source;
    return *this;
  }
  template <typename Number>
  requires(std::is_arithmetic_v<Number> && !std::same_as<Number, char>) const TextStream&
  operator<<(Number number) const {
    *out_ << number;
    return *this;
  }
  // std::endl and std::flush
  const TextStream& operator<<(std::ostream& (*manipulator)(std::ostream&)) const {
    *out_ << manipulator;
    return *this;
  }
  // The bytes as they are, for documents that programs read.
  void Raw(absl::string_view document) const { *out_ << document; }

  // False once something could not be written: what is printed from then on is lost, and the end of
  // the process says why.
  bool ok() const { return out_->good(); }
  // What reads the stream has closed it, and waits for nothing more.
  void Close() const { out_->setstate(std::ios::badbit); }

 private:
  std::ostream* out_;
};

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_CLI_TEXT_STREAM_H_
