// Where the segments of an audit log are read from.
#ifndef RIPS_POLICY_SERVER_AUDIT_SEGMENTS_H_
#define RIPS_POLICY_SERVER_AUDIT_SEGMENTS_H_

#include <cstdint>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::audit {

// `00000007.audit`.
std::string SegmentName(uint64_t number);
// 0 = not the name of a segment.
uint64_t SegmentNumber(absl::string_view name);

class Segments {
 public:
  static constexpr uint64_t kAll = std::numeric_limits<uint64_t>::max();

  virtual ~Segments() = default;
  // Names of segments, by their number.
  virtual absl::StatusOr<std::vector<std::string>> Names() const = 0;
  // The first `bytes_max` bytes.
  virtual absl::StatusOr<std::string> Read(absl::string_view name, uint64_t bytes_max) const = 0;
};

// Those in a directory; other files there are ignored.
class SegmentsInDirectory final : public Segments {
 public:
  explicit SegmentsInDirectory(std::string directory) : directory_(std::move(directory)) {}
  absl::StatusOr<std::vector<std::string>> Names() const override;
  absl::StatusOr<std::string> Read(absl::string_view name, uint64_t bytes_max) const override;

 private:
  std::string directory_;
};

}  // namespace rips::audit

#endif  // RIPS_POLICY_SERVER_AUDIT_SEGMENTS_H_
