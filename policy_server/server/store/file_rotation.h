// Moves a file that is full to FILE.1, and older ones up to FILE.2 and so on.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_FILE_ROTATION_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_FILE_ROTATION_H_

#include <functional>
#include <string>

#include "absl/status/status.h"

namespace rips::store {

// As rename(2): 0, or -1 and errno.
using RenameFile = std::function<int(const char* from, const char* to)>;

// `path` becomes `path`.1. Of the files from there on, only those before the first free number move
// up by one, the highest first, so that a process that is killed between two renames leaves each
// file under one name, and the next call goes on at the gap. Without a gap `path`.KEEP is replaced.
// Nothing is followed: a number that is not a regular file is FailedPrecondition, and then nothing
// has moved. Unavailable: a rename failed; the files before it have moved, `path` has not.
// `keep` is at least 1.
absl::Status RotateFile(const std::string& path, int keep, const RenameFile& rename_file);

// `path`.`number`.
std::string RotatedName(const std::string& path, int number);

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_FILE_ROTATION_H_
