// rosbag2 bags: a directory with storage files (.mcap, .db3) and `metadata.yaml`, which rosbag2
// writes when a recording ends.
//
// The files come in the order of `relative_file_paths`; all in the order of the numbers in their
// names if that is the same order, or if there is no metadata. What the directory lacks is named,
// in Recorded::missing_before of the next event or, after the last one, as DataLoss:
//
//   | the directory                                  | is read        | named                   |
//   |------------------------------------------------|----------------|-------------------------|
//   | has no metadata.yaml, or an unusable one       | all files      | that, at the end        |
//   | lacks a file that the metadata names           | the others     | the file, in its place  |
//   | has a file that the metadata does not name     | that, too      | the file, at the end    |
//   | has a file that is cut, damaged or empty       | its whole part | the file and the byte   |
//   | has a compressed file, and not its content     | the others     | how to decompress it    |
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_BAG_FOLDER_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_BAG_FOLDER_H_

#include <cstddef>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "policy_server/policy/recording/reader.h"

namespace rips::recording {

// Length of metadata.yaml, bytes; files of one bag, and entries of its directory. Inclusive.
inline constexpr size_t kBagMetadataBytesMax = size_t{4} << 20;
inline constexpr size_t kBagFilesMax = 10'000;

// A file is opened when it is reached. FailedPrecondition: no file of a bag. InvalidArgument: the
// metadata names a file outside of the directory, only compressed files, or compressed messages.
absl::StatusOr<std::unique_ptr<Reader>> OpenBagFolder(const std::string& directory);

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_BAG_FOLDER_H_
