#include "policy_server/policy/recording/bag_copy.h"

#include <stdlib.h>
#include <sys/stat.h>

#include <cerrno>
#include <filesystem>
#include <fstream>
#include <optional>
#include <system_error>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "services/base/status_macros.h"

namespace rips::recording {
namespace {

namespace fs = std::filesystem;

// SQLite file format, 1.3: offsets in the header, big endian.
constexpr size_t kHeaderBytes = 100;
constexpr size_t kPageBytesAt = 16;
constexpr size_t kChangesAt = 24;
constexpr size_t kPagesAt = 28;
constexpr size_t kPagesValidForAt = 92;
// First and, if it names another file, last bytes of a rollback journal.
constexpr absl::string_view kJournalMagic("\xd9\xd5\x05\xf9\x20\xa1\x63\xd7", 8);

uint32_t BigEndian(absl::string_view bytes, size_t at, size_t count) {
  uint32_t number = 0;
  for (const char c : bytes.substr(at, count)) number = number << 8 | static_cast<uint8_t>(c);
  return number;
}

// The `count` bytes at `at`; empty if they are not there.
std::string BytesAt(const std::string& path, uint64_t at, size_t count) {
  std::ifstream in(path, std::ios::binary);
  std::string bytes(count, '\0');
  in.seekg(static_cast<std::streamoff>(at));
  in.read(bytes.data(), static_cast<std::streamsize>(count));
  return in ? bytes : std::string();
}

// Length of a regular file; 0 if there is none.
uint64_t LengthOf(const std::string& path) {
  struct stat info {};
  return stat(path.c_str(), &info) == 0 && S_ISREG(info.st_mode)
             ? static_cast<uint64_t>(info.st_size)
             : 0;
}

struct Pages {
  uint64_t bytes;
  // That the header promises.
  uint64_t promised;
};

// Nullopt if the header is none that SQLite takes.
std::optional<Pages> PagesOf(const std::string& path, uint64_t bytes) {
  const std::string header = BytesAt(path, 0, kHeaderBytes);
  if (header.empty()) return std::nullopt;
  uint64_t page_bytes = BigEndian(header, kPageBytesAt, 2);
  if (page_bytes == 1) page_bytes = 65'536;
  if (page_bytes < 512 || (page_bytes & (page_bytes - 1)) != 0) return std::nullopt;
  const uint64_t counted = BigEndian(header, kPagesAt, 4);
  // Old versions of SQLite do not keep the count up to date.
  const bool valid =
      counted > 0 && BigEndian(header, kChangesAt, 4) == BigEndian(header, kPagesValidForAt, 4);
  return Pages{.bytes = page_bytes,
               .promised = valid ? counted : (bytes + page_bytes - 1) / page_bytes};
}

}  // namespace

BagCopy::~BagCopy() {
  std::error_code ignored;
  if (is_copy()) fs::remove_all(directory_, ignored);
}

absl::StatusOr<std::unique_ptr<BagCopy>> BagCopy::Make(const std::string& path, uint64_t bytes) {
  std::unique_ptr<BagCopy> copy(new BagCopy(path));
  copy->bytes_ = bytes;
  const std::string journal = absl::StrCat(path, "-journal");
  const uint64_t wal_bytes = LengthOf(absl::StrCat(path, "-wal"));
  // One without the magic is what is left of a transaction that has ended.
  const bool hot = BytesAt(journal, 0, kJournalMagic.size()) == kJournalMagic;
  if (wal_bytes > 0 || hot) {
    const char* suffix = wal_bytes > 0 ? "-wal" : "-journal";
    copy->bytes_ += wal_bytes > 0 ? wal_bytes : LengthOf(journal);
    RIPS_RETURN_IF_ERROR(copy->Copy(path, bytes, ""));
    RIPS_RETURN_IF_ERROR(copy->Copy(path, wal_bytes > 0 ? wal_bytes : LengthOf(journal), suffix));
    copy->end_ = absl::DataLossError(
        absl::StrCat("the file was not closed, or is still being written: `", path, suffix,
                     "` is there, and was read too; what came later is not there"));
    RIPS_RETURN_IF_ERROR(copy->DropForeignJournal());
    return copy;
  }
  const std::optional<Pages> pages = PagesOf(path, bytes);
  if (!pages.has_value() || pages->promised * pages->bytes <= bytes) return copy;
  const uint64_t whole = bytes / pages->bytes;
  copy->end_ = absl::DataLossError(absl::StrCat("byte ", bytes, ": the file is cut: ", bytes,
                                                " bytes of ", pages->promised * pages->bytes));
  if (whole == 0) return copy->end_;
  RIPS_RETURN_IF_ERROR(copy->Copy(path, bytes, ""));
  RIPS_RETURN_IF_ERROR(copy->Shorten(pages->bytes, whole));
  return copy;
}

absl::Status BagCopy::Copy(const std::string& from, uint64_t bytes, const std::string& suffix) {
  std::error_code failed;
  if (directory_.empty()) {
    const fs::path temporary = fs::temp_directory_path(failed);
    std::string made = (temporary / "rips-bag-XXXXXX").string();
    if (failed || mkdtemp(made.data()) == nullptr) {
      return absl::UnavailableError(absl::StrCat(
          "cannot make a directory for a copy of it in `", temporary.string(), "`: ",
          failed ? failed.message() : std::error_code(errno, std::generic_category()).message(),
          "; set TMPDIR"));
    }
    directory_ = made;
    path_ = absl::StrCat(directory_, "/bag.db3");
  }
  const fs::space_info space = fs::space(directory_, failed);
  if (!failed && space.available < bytes) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "a copy of it needs ", bytes, " bytes in `", fs::path(directory_).parent_path().string(),
        "`, which has ", space.available, " left; set TMPDIR"));
  }
  if (!failed) {
    fs::copy_file(absl::StrCat(from, suffix), absl::StrCat(path_, suffix), failed);
  }
  if (!failed) fs::permissions(absl::StrCat(path_, suffix), fs::perms(0600), failed);
  if (!failed) return absl::OkStatus();
  return absl::UnavailableError(absl::StrCat("cannot copy it into `",
                                             fs::path(directory_).parent_path().string(),
                                             "`: ", failed.message(), "; set TMPDIR"));
}

// A journal of several databases names a file, which SQLite would read and delete. rosbag2 makes
// none.
absl::Status BagCopy::DropForeignJournal() {
  const std::string journal = absl::StrCat(path_, "-journal");
  const uint64_t bytes = LengthOf(journal);
  if (bytes < kJournalMagic.size() ||
      BytesAt(journal, bytes - kJournalMagic.size(), kJournalMagic.size()) != kJournalMagic) {
    return absl::OkStatus();
  }
  std::error_code failed;
  fs::remove(journal, failed);
  if (failed) return absl::UnavailableError(failed.message());
  end_ = absl::DataLossError("its journal is one of several databases, and was not applied");
  return absl::OkStatus();
}

// SQLite refuses a file that is shorter than its header says, and takes what is missing from the
// last page for zeros.
absl::Status BagCopy::Shorten(uint64_t page_bytes, uint64_t pages) {
  std::error_code failed;
  fs::resize_file(path_, page_bytes * pages, failed);
  std::fstream file(path_, std::ios::binary | std::ios::in | std::ios::out);
  const std::string changes = BytesAt(path_, kChangesAt, 4);
  const char count[] = {static_cast<char>(pages >> 24), static_cast<char>(pages >> 16),
                        static_cast<char>(pages >> 8), static_cast<char>(pages)};
  file.seekp(kPagesAt);
  file.write(count, sizeof(count));
  file.seekp(kPagesValidForAt);
  file.write(changes.data(), static_cast<std::streamsize>(changes.size()));
  file.close();
  if (!failed && file) return absl::OkStatus();
  return absl::UnavailableError("cannot write the copy of it; set TMPDIR");
}

}  // namespace rips::recording
