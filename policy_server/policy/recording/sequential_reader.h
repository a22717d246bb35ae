// What all readers share: indices, and an end or error that stays. Internal to this folder.
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_SEQUENTIAL_READER_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_SEQUENTIAL_READER_H_

#include <cstdint>
#include <optional>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "policy_server/policy/recording/reader.h"

namespace rips::recording {

class SequentialReader : public Reader {
 public:
  absl::StatusOr<std::optional<Recorded>> Next() final {
    if (!broken_.ok()) return broken_;
    if (ended_) return std::nullopt;
    absl::StatusOr<std::optional<Recorded>> next = Read();
    if (!next.ok()) {
      broken_ = next.status();
    } else if (!next->has_value()) {
      ended_ = true;
    } else {
      (*next)->index = next_index_++;
    }
    return next;
  }

 protected:
  // As Next; not called again after the end or an error. The index is set by the caller.
  virtual absl::StatusOr<std::optional<Recorded>> Read() = 0;

 private:
  absl::Status broken_;
  bool ended_ = false;
  uint64_t next_index_ = 0;
};

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_SEQUENTIAL_READER_H_
