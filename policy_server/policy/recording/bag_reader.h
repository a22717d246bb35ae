// rosbag2 storage files of SQLite (.db3), of any schema version so far: tables
//   topics(id, name, type, serialization_format, ...)
//   messages(id, topic_id, timestamp, data)
//
// Messages come by timestamp, then id; the timestamp is their time. The file is opened read-only
// and as immutable: nothing is locked, and nothing is written beside it.
//
// A file that was not closed or was cut is read as a copy (bag_copy.h). Of one that is damaged, or
// whose copy is, the rows come that precede the damage in the order of their ids, as far as their
// data is there; then DataLoss.
//
// Memory: one message, one row a topic, and SQLite's page cache. Without the index on timestamps
// that rosbag2 makes, SQLite sorts ids and timestamps, in temporary files if they are many.
//
// A hostile file can make SQLite walk in circles: the work it may do is bounded by the file's
// length, and messages must come in strictly ascending order.
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_BAG_READER_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_BAG_READER_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/recording/reader.h"

namespace rips::recording {

inline constexpr absl::string_view kSqliteMagic("SQLite format 3\0", 16);

// Topics of one file. Inclusive.
inline constexpr size_t kBagTopicsMax = 65'536;

// InvalidArgument also: a topic whose serialization format is not `cdr`, tables that are views or
// have computed columns. ResourceExhausted also: no room for a copy. `bytes` is the length of the
// file.
absl::StatusOr<std::unique_ptr<Reader>> OpenBagFile(const std::string& path, uint64_t bytes);

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_BAG_READER_H_
