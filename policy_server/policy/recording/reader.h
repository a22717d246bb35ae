// Recordings of robot traffic, for replay. What a file is, is decided by its first bytes:
//
//   directory                        rosbag2 bag: the files that are there        bag_folder.h
//   "SQLite format 3\0"              rosbag2 storage file (.db3)                  bag_reader.h
//   MCAP magic                       MCAP                                         mcap_reader.h
//   magic of FORMAT.md               our own                                      rips_reader.h
//   magic of gzip, zstd, lz4, ...    refused, with the command that decompresses it
//   anything else                    the prototype's YAML event stream            yaml_reader.h
//
// Of a recording that was cut (power failure, full disk) or damaged, a reader gives every whole
// event before that place, then DataLoss that names the file and the byte.
//
// The same file gives the same events, always. Memory is bounded by the limits that each reader
// states, not by the length of the recording. A file must not change while it is read.
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_READER_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_READER_H_

#include <cstddef>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "policy_server/policy/recording/recorded.h"

namespace rips::recording {

// Largest serialized payload of one message that any reader gives, in bytes.
inline constexpr size_t kMessageBytesMax = size_t{64} << 20;
// Longest topic or type name, in bytes.
inline constexpr size_t kNameBytesMax = 1'024;

// Not thread-safe.
class Reader {
 public:
  virtual ~Reader() = default;

  // The next event; nullopt at the end, then and ever after. DataLoss: the file is cut or damaged,
  // or a bag lacks a file; what was given before is right.
  // InvalidArgument: it holds what cannot be replayed. ResourceExhausted: past a limit.
  // Unavailable: it cannot be read. The message names the file, the place and what is wrong. After
  // an error every call gives that error.
  absl::StatusOr<std::optional<Recorded>> Next();
  // The recording knows the graph. If not, questions about the graph cannot be decided.
  virtual bool has_graph() const = 0;

  // Null unless the recording says where it comes from. Valid while this lives.
  virtual const RecordedOrigin* origin() const { return nullptr; }

 private:
  // As Next, which sets the index; not called again after the end or an error.
  virtual absl::StatusOr<std::optional<Recorded>> Read() = 0;

  absl::Status broken_;
  bool ended_ = false;
  uint64_t next_index_ = 0;
};

// NotFound: no such file. FailedPrecondition: neither a file nor a bag directory. Otherwise as
// Reader::Next.
absl::StatusOr<std::unique_ptr<Reader>> Open(const std::string& path);

// The same, without directories.
absl::StatusOr<std::unique_ptr<Reader>> OpenFile(const std::string& path);

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_READER_H_
