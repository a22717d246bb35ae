#include "policy_server/policy/bundle/bundle_archive.h"

#include <google/protobuf/io/coded_stream.h>
#include <sys/stat.h>

#include <cerrno>
#include <cstdint>
#include <filesystem>
#include <system_error>
#include <utility>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/policy/bundle/bundle_contents.h"
#include "policy_server/policy/bundle/bundle_files.h"
#include "policy_server/policy/bundle/bundle_signature.h"
#include "policy_server/policy/bundle/manifest.h"
#include "rips/v1/operator.pb.h"
#include "services/base/status_macros.h"
#include "services/text/quote.h"

namespace rips::bundle {
namespace {

namespace fs = std::filesystem;

// What a manifest may list, with the manifest and the signature.
constexpr size_t kArchiveFilesMax = 1 + kRuleFilesMax + 2 * kInspectionFilesMax + 1;

// The only kind of field that the messages have.
constexpr uint32_t kLengthDelimited = 2;

struct WireField {
  uint32_t number = 0;
  absl::string_view bytes;
};

// One of an archive; views into it.
struct ArchivedFile {
  absl::string_view path;
  absl::string_view data;
};

absl::Status Refuse(absl::string_view why) {
  return absl::InvalidArgumentError(absl::StrCat("archive of a bundle: ", why));
}

absl::Status Refuse(absl::string_view path, absl::string_view why) {
  return Refuse(absl::StrCat(QuoteBytes(path), " ", why));
}

// The fields of a message in their order; `what` names them. Not protobuf's own parser, which needs
// many times the memory of a message that has many small files or unknown fields.
absl::StatusOr<std::vector<WireField>> ReadFields(absl::string_view message, size_t fields_max,
                                                  absl::string_view what) {
  std::vector<WireField> fields;
  google::protobuf::io::CodedInputStream in(reinterpret_cast<const uint8_t*>(message.data()),
                                            static_cast<int>(message.size()));
  while (const uint32_t tag = in.ReadTag()) {
    uint32_t bytes = 0;
    if ((tag & 7) != kLengthDelimited || !in.ReadVarint32(&bytes)) {
      return Refuse("it is not a serialized BundleArchive");
    }
    const auto at = static_cast<size_t>(in.CurrentPosition());
    if (bytes > message.size() - at) return Refuse("it ends in the middle of a file");
    if (fields.size() == fields_max) {
      return Refuse(absl::StrCat("it has more than ", fields_max, " ", what));
    }
    fields.push_back({tag >> 3, message.substr(at, bytes)});
    in.Skip(static_cast<int>(bytes));
  }
  if (!in.ConsumedEntireMessage()) return Refuse("it is not a serialized BundleArchive");
  return fields;
}

absl::StatusOr<ArchivedFile> ReadFileFields(absl::string_view message) {
  RIPS_ASSIGN_OR_RETURN(const std::vector<WireField> fields,
                        ReadFields(message, 2, "fields of a file"));
  ArchivedFile file;
  uint32_t last = 0;
  for (const WireField& field : fields) {
    const bool is_path = field.number == v1::BundleFile::kPathFieldNumber;
    if (!is_path && field.number != v1::BundleFile::kDataFieldNumber) {
      return Refuse(absl::StrCat("a file has the unknown field ", field.number));
    }
    if (field.number == last) return Refuse("a file has two paths or two contents");
    last = field.number;
    (is_path ? file.path : file.data) = field.bytes;
  }
  return file;
}

absl::StatusOr<std::vector<ArchivedFile>> ReadArchive(absl::string_view archive) {
  if (archive.size() > kArchiveBytesMax) {
    return Refuse(absl::StrCat("it has ", archive.size(), " bytes, limit ", kArchiveBytesMax));
  }
  RIPS_ASSIGN_OR_RETURN(const std::vector<WireField> fields,
                        ReadFields(archive, kArchiveFilesMax, "files"));
  std::vector<ArchivedFile> files;
  for (const WireField& field : fields) {
    if (field.number != v1::BundleArchive::kFilesFieldNumber) {
      return Refuse(absl::StrCat("it has the unknown field ", field.number));
    }
    RIPS_ASSIGN_OR_RETURN(const ArchivedFile file, ReadFileFields(field.bytes));
    files.push_back(file);
  }
  return files;
}

// The files by path: each path good, there once, and not a directory of another file's.
using FilesByPath = absl::btree_map<absl::string_view, absl::string_view>;
absl::StatusOr<FilesByPath> ByPath(const std::vector<ArchivedFile>& files) {
  FilesByPath by_path;
  for (const ArchivedFile& file : files) {
    if (const absl::Status good = CheckBundlePath(file.path); !good.ok()) {
      return Refuse(good.message());
    }
    if (!by_path.emplace(file.path, file.data).second) return Refuse(file.path, "is there twice");
  }
  for (const auto& [path, data] : by_path) {
    for (size_t slash = path.find('/'); slash != path.npos; slash = path.find('/', slash + 1)) {
      const absl::string_view above = path.substr(0, slash);
      if (!by_path.contains(above)) continue;
      return Refuse(above, absl::StrCat("is a file, and the directory of `", path, "`"));
    }
  }
  return by_path;
}

// The files to write, with their content.
using Written = std::vector<std::pair<ContentFile, absl::string_view>>;
absl::StatusOr<Written> CheckFiles(absl::string_view archive) {
  RIPS_ASSIGN_OR_RETURN(const std::vector<ArchivedFile> files, ReadArchive(archive));
  if (files.empty() || files.front().path != kManifestName) {
    return Refuse(absl::StrCat("it does not begin with `", kManifestName, "`"));
  }
  RIPS_ASSIGN_OR_RETURN(FilesByPath by_path, ByPath(files));
  if (files.front().data.size() > kManifestBytesMax) {
    return Refuse(kManifestName, absl::StrCat("has more than ", kManifestBytesMax, " bytes"));
  }
  RIPS_ASSIGN_OR_RETURN(const Manifest manifest, ParseManifest(kManifestName, files.front().data));
  std::vector<ContentFile> expected = ListContents(manifest);
  if (by_path.contains(kSignatureName)) expected.push_back({kSignatureName, kSignatureBytesMax});
  Written written;
  for (ContentFile& file : expected) {
    const auto found = by_path.find(file.path);
    if (found == by_path.end()) return Refuse(file.path, "is listed by the manifest and missing");
    if (found->second.size() > file.bytes_max) {
      return Refuse(file.path, absl::StrCat("has more than ", file.bytes_max, " bytes"));
    }
    written.emplace_back(std::move(file), found->second);
    by_path.erase(found);
  }
  if (!by_path.empty()) {
    return Refuse(by_path.begin()->first, "is not listed by the manifest");
  }
  return written;
}

std::string ParentOf(const std::string& dir) {
  const fs::path path(dir);
  return path.has_parent_path() ? path.parent_path().string() : ".";
}

absl::Status WriteAll(const Written& written, const std::string& dir) {
  for (const auto& [file, data] : written) RIPS_RETURN_IF_ERROR(WriteContent(dir, file, data));
  RIPS_RETURN_IF_ERROR(SyncDirectories(dir));
  return SyncPath(ParentOf(dir));
}

}  // namespace

absl::StatusOr<std::string> PackBundle(const std::string& dir) {
  v1::BundleArchive archive;
  size_t bytes_left = kArchiveBytesMax;
  const auto add = [&](const std::string& path, std::string bytes) -> absl::Status {
    v1::BundleFile* file = archive.add_files();
    file->set_path(path);
    file->set_data(std::move(bytes));
    // With the tag and the length before it.
    const size_t size = file->ByteSizeLong() + 6;
    if (size > bytes_left) {
      return absl::ResourceExhaustedError(absl::StrCat(
          "bundle `", dir, "` has more than ", kArchiveBytesMax, " bytes; use smaller plugins"));
    }
    bytes_left -= size;
    return absl::OkStatus();
  };
  RIPS_RETURN_IF_ERROR(ReadContents(dir, [&](const ContentFile& file, std::string bytes) {
    return add(file.path, std::move(bytes));
  }));
  RIPS_ASSIGN_OR_RETURN(std::string signature, ReadSignature(dir));
  if (!signature.empty()) RIPS_RETURN_IF_ERROR(add(kSignatureName, std::move(signature)));
  return archive.SerializeAsString();
}

absl::Status UnpackBundle(absl::string_view archive, const std::string& dir) {
  RIPS_ASSIGN_OR_RETURN(const Written written, CheckFiles(archive));
  std::error_code error;
  fs::create_directories(ParentOf(dir), error);
  if (error) return FileError(error.value(), "making the directory of", dir);
  if (mkdir(dir.c_str(), 0777) != 0) {
    if (errno == EEXIST) return absl::AlreadyExistsError(absl::StrCat("`", dir, "` exists"));
    return FileError(errno, "making", dir);
  }
  absl::Status status = WriteAll(written, dir);
  if (!status.ok()) fs::remove_all(dir, error);
  return status;
}

}  // namespace rips::bundle
