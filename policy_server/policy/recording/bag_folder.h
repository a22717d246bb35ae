// rosbag2 bags: a directory with `metadata.yaml` and the files it names.
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_BAG_FOLDER_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_BAG_FOLDER_H_

#include <cstddef>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "policy_server/policy/recording/reader.h"

namespace rips::recording {

// Length of metadata.yaml, bytes; files of one bag. Inclusive.
inline constexpr size_t kBagMetadataBytesMax = size_t{4} << 20;
inline constexpr size_t kBagFilesMax = 10'000;

// Gives the messages of one file after the other, in the order of `relative_file_paths`; a file is
// opened when it is reached. FailedPrecondition: no metadata.yaml. InvalidArgument: it is
// malformed, names a file outside of the directory, or says that the bag is compressed.
absl::StatusOr<std::unique_ptr<Reader>> OpenBagFolder(const std::string& directory);

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_BAG_FOLDER_H_
