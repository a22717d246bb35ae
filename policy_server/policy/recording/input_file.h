// A file read from front to back. Internal to this folder.
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_INPUT_FILE_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_INPUT_FILE_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::recording {

// Not thread-safe.
class InputFile {
 public:
  // NotFound, PermissionDenied, FailedPrecondition if it is no regular file, Unavailable.
  static absl::StatusOr<std::unique_ptr<InputFile>> Open(const std::string& path);
  ~InputFile();
  InputFile(const InputFile&) = delete;
  InputFile& operator=(const InputFile&) = delete;

  const std::string& path() const { return path_; }
  // Bytes; as it was when opened.
  uint64_t size() const { return size_; }
  // Of the next byte, from 0.
  uint64_t offset() const { return offset_; }
  uint64_t remaining() const { return size_ - offset_; }

  // The next `count` bytes. DataLoss, and nothing is read or allocated, if fewer remain.
  absl::Status Read(uint64_t count, std::string* out);
  // The next line with its line break, if it has one. False at the end. ResourceExhausted if it is
  // longer than `bytes_max`.
  absl::StatusOr<bool> ReadLine(size_t bytes_max, std::string* line);
  // Goes back to the first byte.
  void Rewind();

  // DataLoss "`path`: byte 12: what".
  absl::Status Damaged(uint64_t at, absl::string_view what) const;

 private:
  InputFile(int fd, std::string path, uint64_t size);
  // Makes the buffer hold at least one byte; there is one.
  absl::Status Fill();

  const int fd_;
  const std::string path_;
  const uint64_t size_;
  uint64_t offset_ = 0;
  // Bytes of the file from offset_ on: buffer_[used_..].
  std::string buffer_;
  size_t used_ = 0;
};

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_INPUT_FILE_H_
