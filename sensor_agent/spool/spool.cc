#include "sensor_agent/spool/spool.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <set>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/file_lock.h"

namespace rips::sensor {

namespace {

constexpr char kLockName[] = "lock";
constexpr char kRunningName[] = "running";
constexpr char kProbeName[] = "probe";
constexpr size_t kProblemsMax = 20;
// A segment is closed when it is longer than segment_bytes, so one frame more at most.
constexpr size_t kSegmentSlackBytes = kFrameBytesMax + 4096;

absl::Status Errno(absl::string_view what, const std::string& path) {
  return absl::UnavailableError(absl::StrCat("cannot ", what, " `", path, "`: ", strerror(errno)));
}

void AddProblem(std::string problem, Recovered& recovered) {
  if (recovered.problems.size() < kProblemsMax) recovered.problems.push_back(std::move(problem));
}

}  // namespace

std::string BootId() {
  const absl::StatusOr<std::string> text = ReadFile("/proc/sys/kernel/random/boot_id", 64);
  std::string digits = text.value_or("");
  std::erase_if(digits,
                [](char c) { return !absl::ascii_isxdigit(static_cast<unsigned char>(c)); });
  if (digits.size() != 2 * kBootIdBytes) return std::string(kBootIdBytes, '\0');
  return absl::HexStringToBytes(digits);
}

Spool::Spool(SpoolOptions options, UniqueFd lock, bool unclean)
    : options_(std::move(options)), lock_(std::move(lock)), unclean_(unclean) {}

Spool::~Spool() = default;

absl::StatusOr<std::unique_ptr<Spool>> Spool::Open(SpoolOptions options) {
  std::error_code error;
  std::filesystem::create_directories(options.dir, error);
  if (error) {
    return absl::UnavailableError(
        absl::StrCat("cannot create `", options.dir, "`: ", error.message()));
  }
  const std::string lock_path = absl::StrCat(options.dir, "/", kLockName);
  absl::StatusOr<UniqueFd> lock = LockFile(lock_path);
  if (absl::IsFailedPrecondition(lock.status())) {
    return absl::FailedPreconditionError(absl::StrCat(
        "another process uses the spool `", options.dir, "`; give each sensor a directory"));
  }
  RIPS_RETURN_IF_ERROR(lock.status());
  if (chmod(options.dir.c_str(), 0700) != 0) return Errno("protect", options.dir);
  const std::string running = absl::StrCat(options.dir, "/", kRunningName);
  const bool unclean = std::filesystem::exists(running, error);
  // To be refused now rather than with the first frame.
  const std::string probe = absl::StrCat(options.dir, "/", kProbeName);
  RIPS_RETURN_IF_ERROR(WriteFileAtomically(probe, "can this be written?\n"));
  unlink(probe.c_str());
  return std::unique_ptr<Spool>(new Spool(std::move(options), *std::move(lock), unclean));
}

std::string Spool::PathOf(const SegmentHeader& header) const {
  return absl::StrCat(options_.dir, "/", SegmentName(header));
}

// --- Recovering

Recovered Spool::Recover() {
  Recovered recovered;
  if (absl::Status marked = WriteFileAtomically(absl::StrCat(options_.dir, "/", kRunningName),
                                                "a sensor uses this directory\n");
      !marked.ok()) {
    AddProblem(std::string(marked.message()), recovered);
  }
  std::vector<SegmentHeader> named;
  std::error_code error;
  std::filesystem::directory_iterator entry(options_.dir, error);
  for (const std::filesystem::directory_iterator end; !error && entry != end;
       entry.increment(error)) {
    const auto header = ParseSegmentName(entry->path().filename().string());
    if (header.has_value()) named.push_back(*header);
  }
  if (error) {
    AddProblem(absl::StrCat("cannot list `", options_.dir, "`: ", error.message()), recovered);
    recovered.unknown_lost = true;
  }
  std::sort(named.begin(), named.end(),
            [](const auto& a, const auto& b) { return a.index < b.index; });
  if (!named.empty()) next_index_ = named.back().index + 1;
  DropOldIncarnations(named, recovered);
  std::map<StreamKey, uint64_t> next;
  // Streams whose newest segment has no seal: what came behind is not known.
  for (const SegmentHeader& each : named) RecoverSegment(each, recovered, next);
  for (SpoolGap& gap : recovered.gaps) {
    gap.at_end = gap.first_sequence + gap.count == next.at(gap.stream);
  }
  std::set<StreamKey> without_end;
  for (const auto& [index, segment] : segments_) {
    if (segment.next_sequence == 0) {
      without_end.insert(segment.header.stream);
    } else {
      without_end.erase(segment.header.stream);
    }
  }
  if (!without_end.empty() || unclean_) recovered.unknown_lost = true;
  if (unclean_) {
    AddProblem("the sensor before this one did not end in order; what it held in memory is lost",
               recovered);
  }
  std::vector<uint64_t> empty;
  for (const auto& [index, segment] : segments_) {
    if (segment.records == 0) empty.push_back(index);
  }
  for (const uint64_t index : empty) Remove(index);
  return recovered;
}

void Spool::DropOldIncarnations(std::vector<SegmentHeader>& named, Recovered& recovered) {
  std::vector<std::string> newest_first;
  for (auto it = named.rbegin(); it != named.rend(); ++it) {
    const std::string& incarnation = it->stream.incarnation;
    if (std::find(newest_first.begin(), newest_first.end(), incarnation) == newest_first.end()) {
      newest_first.push_back(incarnation);
    }
  }
  if (newest_first.size() <= options_.incarnations) return;
  const std::set<std::string> kept(
      newest_first.begin(), newest_first.begin() + static_cast<ptrdiff_t>(options_.incarnations));
  std::erase_if(named, [&](const SegmentHeader& each) {
    if (kept.contains(each.stream.incarnation)) return false;
    unlink(PathOf(each).c_str());
    return true;
  });
  recovered.unknown_lost = true;
  AddProblem(absl::StrCat("more than ", options_.incarnations,
                          " incarnations are spooled; the oldest ones are given up"),
             recovered);
}

void Spool::RecoverSegment(const SegmentHeader& named, Recovered& recovered,
                           std::map<StreamKey, uint64_t>& next) {
  const std::string path = PathOf(named);
  const auto damaged = [&](absl::string_view why) {
    AddProblem(absl::StrCat("`", SegmentName(named), "`: ", why), recovered);
  };
  absl::StatusOr<std::string> file = ReadFile(path, options_.segment_bytes + kSegmentSlackBytes);
  if (!file.ok()) {
    damaged(file.status().message());
    file = std::string();
  }
  const absl::StatusOr<SegmentHeader> header = DecodeSegmentHeader(*file);
  if (!header.ok()) damaged(header.status().message());
  Segment& segment = segments_[named.index];
  segment.header = named;
  segment.seed = FrameSeed(named);
  segment.bytes = file->size();
  bytes_ += segment.bytes;
  // Times of another boot are converted by the wall clock. Without the header nobody knows: then
  // they are from long ago.
  if (header.ok() && header->boot_id != options_.boot_id) {
    segment.time_shift_ns =
        header->unix_minus_boottime_ns - (options_.now.unix_ns - options_.now.boottime_ns);
  } else if (!header.ok()) {
    segment.time_shift_ns = -options_.now.boottime_ns;
  }
  uint64_t& expected = next.try_emplace(named.stream, named.first_sequence).first->second;
  const auto gap_until = [&](uint64_t sequence) {
    if (sequence <= expected) return;
    recovered.gaps.push_back(
        {.stream = named.stream, .first_sequence = expected, .count = sequence - expected});
    expected = sequence;
  };
  gap_until(named.first_sequence);
  FrameScanner scanner(segment.seed, *file);
  bool sealed = false;
  while (const std::optional<Frame> frame = scanner.Next()) {
    if (frame->first_sequence < expected) {
      damaged("a frame that repeats others is skipped");
      continue;
    }
    gap_until(frame->first_sequence);
    sealed = frame->count == 0;
    if (sealed) continue;
    expected = frame->first_sequence + frame->count;
    ++segment.records;
    recovered.records.push_back({.stream = named.stream,
                                 .first_sequence = frame->first_sequence,
                                 .count = frame->count,
                                 .oldest_ns = frame->oldest_ns + segment.time_shift_ns,
                                 .time_shift_ns = segment.time_shift_ns,
                                 .segment = named.index,
                                 .offset = frame->offset,
                                 .bytes = kFrameHeaderBytes + frame->payload.size()});
  }
  if (scanner.skipped() > 0) damaged(absl::StrCat(scanner.skipped(), " bytes are damaged"));
  if (!sealed) damaged("it has no end");
  // 0 = not known where it ended.
  segment.next_sequence = sealed ? expected : 0;
}

// --- Appending

absl::StatusOr<Spool::Segment*> Spool::OpenSegment(const StreamKey& stream,
                                                   uint64_t first_sequence) {
  if (const auto it = open_.find(stream); it != open_.end()) return &segments_.at(it->second);
  Segment segment;
  segment.header = {.stream = stream,
                    .index = next_index_,
                    .first_sequence = first_sequence,
                    .boot_id = options_.boot_id,
                    .unix_minus_boottime_ns = options_.now.unix_ns - options_.now.boottime_ns};
  segment.seed = FrameSeed(segment.header);
  segment.next_sequence = first_sequence;
  const std::string path = PathOf(segment.header);
  segment.fd = UniqueFd(
      open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_APPEND | O_CLOEXEC | O_NOFOLLOW, 0600));
  if (segment.fd.get() < 0) return Errno("create", path);
  ++next_index_;
  Segment& kept = segments_[segment.header.index] = std::move(segment);
  if (absl::Status written = WriteAll(kept, EncodeSegmentHeader(kept.header)); !written.ok()) {
    Remove(kept.header.index);
    return written;
  }
  open_[stream] = kept.header.index;
  return &kept;
}

absl::Status Spool::WriteAll(Segment& segment, absl::string_view bytes) {
  const size_t before = segment.bytes;
  while (!bytes.empty()) {
    const ssize_t written = write(segment.fd.get(), bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) {
      const absl::Status status = Errno("write", PathOf(segment.header));
      // If this fails, too, a cut frame stays there, which readers skip.
      if (ftruncate(segment.fd.get(), static_cast<off_t>(before)) == 0) {
        bytes_ -= segment.bytes - before;
        segment.bytes = before;
      }
      return status;
    }
    bytes.remove_prefix(static_cast<size_t>(written));
    segment.bytes += static_cast<size_t>(written);
    bytes_ += static_cast<uint64_t>(written);
  }
  return absl::OkStatus();
}

absl::StatusOr<SpoolRecord> Spool::Append(const StreamKey& stream, const Frame& frame) {
  const size_t bytes = kFrameHeaderBytes + frame.payload.size();
  // Room for a header and two seals more, so that closing never goes beyond.
  if (bytes_ + bytes + kSegmentHeaderBytes + 2 * kFrameHeaderBytes > options_.disk_bytes) {
    return absl::ResourceExhaustedError(
        absl::StrCat("the spool holds ", bytes_, " bytes; the limit is ", options_.disk_bytes));
  }
  RIPS_ASSIGN_OR_RETURN(Segment * segment, OpenSegment(stream, frame.first_sequence));
  std::string encoded;
  AppendFrame(segment->seed, frame, &encoded);
  const size_t offset = segment->bytes;
  if (absl::Status written = WriteAll(*segment, encoded); !written.ok()) {
    if (segment->bytes == offset) return written;
    // What is behind a cut frame would be found, but not at its place: go on in another segment.
    Close(*segment, /*seal=*/false).IgnoreError();  // the error that matters is the first
    if (segment->records == 0) Remove(segment->header.index);
    return written;
  }
  segment->next_sequence = frame.first_sequence + frame.count;
  ++segment->records;
  const SpoolRecord record{.stream = stream,
                           .first_sequence = frame.first_sequence,
                           .count = frame.count,
                           .oldest_ns = frame.oldest_ns,
                           .segment = segment->header.index,
                           .offset = offset,
                           .bytes = encoded.size()};
  // The frame is there. Whether it outlives a power cut now or later, the reader will see.
  if (segment->bytes >= options_.segment_bytes) Close(*segment, /*seal=*/true).IgnoreError();
  return record;
}

absl::Status Spool::Close(Segment& segment, bool seal) {
  absl::Status status;
  if (seal) {
    std::string end;
    AppendFrame(segment.seed, {.first_sequence = segment.next_sequence}, &end);
    status = WriteAll(segment, end);
  }
  if (fdatasync(segment.fd.get()) != 0) status.Update(Errno("sync", PathOf(segment.header)));
  segment.fd.Reset();
  open_.erase(segment.header.stream);
  return status;
}

absl::Status Spool::MarkClean() {
  absl::Status status;
  std::vector<uint64_t> open;
  for (const auto& [stream, index] : open_) open.push_back(index);
  for (const uint64_t index : open) status.Update(Close(segments_.at(index), /*seal=*/true));
  RIPS_RETURN_IF_ERROR(status);
  const std::string running = absl::StrCat(options_.dir, "/", kRunningName);
  if (unlink(running.c_str()) != 0) return Errno("remove", running);
  return absl::OkStatus();
}

// --- Reading

absl::StatusOr<std::string> Spool::Read(const SpoolRecord& record) const {
  const auto it = segments_.find(record.segment);
  if (it == segments_.end()) return absl::DataLossError("its segment is gone");
  const std::string path = PathOf(it->second.header);
  const UniqueFd fd(open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW));
  if (fd.get() < 0) return absl::DataLossError(Errno("open", path).message());
  std::string bytes(record.bytes, '\0');
  size_t done = 0;
  while (done < bytes.size()) {
    const ssize_t got = pread(fd.get(), bytes.data() + done, bytes.size() - done,
                              static_cast<off_t>(record.offset + done));
    if (got < 0 && errno == EINTR) continue;
    if (got <= 0) return absl::DataLossError(Errno("read", path).message());
    done += static_cast<size_t>(got);
  }
  RIPS_ASSIGN_OR_RETURN(const Frame frame, DecodeFrame(it->second.seed, bytes));
  if (frame.first_sequence != record.first_sequence || frame.count != record.count) {
    return absl::DataLossError("another frame than was written");
  }
  return std::string(frame.payload);
}

void Spool::Release(const SpoolRecord& record) {
  const auto it = segments_.find(record.segment);
  if (it == segments_.end() || it->second.records == 0) return;
  if (--it->second.records == 0) Remove(record.segment);
}

void Spool::Remove(uint64_t index) {
  const auto it = segments_.find(index);
  if (it == segments_.end()) return;
  unlink(PathOf(it->second.header).c_str());
  bytes_ -= it->second.bytes;
  if (const auto open = open_.find(it->second.header.stream);
      open != open_.end() && open->second == index) {
    open_.erase(open);
  }
  segments_.erase(it);
}

}  // namespace rips::sensor
