// Recordings made for tests. Test code only.
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_RECORDING_TEST_DATA_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_RECORDING_TEST_DATA_H_

#include <sqlite3.h>
#include <stdlib.h>

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/policy/recording/event_codec.h"
#include "policy_server/policy/recording/little_endian.h"
#include "policy_server/policy/recording/mcap_reader.h"
#include "policy_server/policy/recording/reader.h"
#include "services/base/status_matchers.h"

namespace rips::recording {

// A directory that goes when this goes.
class TempFolder {
 public:
  TempFolder() {
    std::string path = testing::TempDir() + "/rips-recording-XXXXXX";
    EXPECT_NE(mkdtemp(path.data()), nullptr);
    path_ = path;
  }
  ~TempFolder() { std::filesystem::remove_all(path_); }
  const std::string& path() const { return path_; }
  std::string File(absl::string_view name) const { return absl::StrCat(path_, "/", name); }
  std::string Write(absl::string_view name, absl::string_view bytes) const {
    const std::string path = File(name);
    std::ofstream(path, std::ios::binary).write(bytes.data(), bytes.size());
    return path;
  }

 private:
  std::string path_;
};

// What a recording gives until its end or its error.
struct Reading {
  std::vector<Recorded> events;
  absl::Status status;
};

inline Reading ReadAll(const std::string& path) {
  Reading reading;
  const auto reader = Open(path);
  reading.status = reader.status();
  while (reading.status.ok()) {
    auto event = (*reader)->Next();
    reading.status = event.status();
    if (!event.ok() || !*event) break;
    EXPECT_EQ((*event)->index, reading.events.size());
    reading.events.push_back(*std::move(*event));
  }
  if (reader.ok()) {
    // The end and an error stay.
    EXPECT_EQ((*reader)->Next().status(), reading.status);
  }
  return reading;
}

// Everything in an event, for comparison.
inline std::string Print(const Recorded& event) {
  return absl::StrCat(event.index, " ", EncodeEvent(event).ShortDebugString());
}
inline std::vector<std::string> Print(const std::vector<Recorded>& events) {
  std::vector<std::string> texts;
  for (const Recorded& event : events) texts.push_back(Print(event));
  return texts;
}

inline const RecordedMessage& MessageOf(const Recorded& event) {
  return std::get<RecordedMessage>(event.what);
}

// Cut after each of its bytes, or every `step`, `bytes` gives a prefix of its events, no more than
// with a later cut, and an error; without an error only if `may_end(cut)`.
template <typename MayEnd>
void ExpectCutsAreSeen(absl::string_view bytes, const MayEnd& may_end, size_t step = 1) {
  const TempFolder folder;
  const std::string path = folder.Write("file", bytes);
  const Reading whole = ReadAll(path);
  ASSERT_THAT(whole.status, IsOk());
  const std::vector<std::string> events = Print(whole.events);
  size_t later = events.size();
  for (size_t cut = bytes.size(); cut >= step && cut > 0;) {
    cut -= step;
    std::filesystem::resize_file(path, cut);
    const Reading part = ReadAll(path);
    const std::vector<std::string> got = Print(part.events);
    ASSERT_LE(got.size(), may_end(cut) ? events.size() : later) << "cut at " << cut;
    later = std::min(later, got.size());
    ASSERT_TRUE(std::equal(got.begin(), got.end(), events.begin())) << "cut at " << cut;
    ASSERT_TRUE(!part.status.ok() || may_end(cut)) << "cut at " << cut;
  }
}
inline void ExpectCutsAreSeen(absl::string_view bytes) {
  ExpectCutsAreSeen(bytes, [](size_t) { return false; });
}

// Changes the bits `mask` of the byte `at`; a second time it changes them back.
inline void FlipBits(const std::string& path, size_t at, int mask) {
  std::fstream file(path, std::ios::binary | std::ios::in | std::ios::out);
  file.seekg(static_cast<std::streamoff>(at));
  const int byte = file.get();
  file.seekp(static_cast<std::streamoff>(at));
  file.put(static_cast<char>(byte ^ mask));
}

// With any one bit of the bytes [begin, end) flipped, the recording is refused somewhere.
inline void ExpectFlipsAreSeen(absl::string_view bytes, size_t begin, size_t end) {
  const TempFolder folder;
  const std::string path = folder.Write("file", bytes);
  ASSERT_THAT(ReadAll(path).status, IsOk());
  for (size_t bit = begin * 8; bit < end * 8; ++bit) {
    FlipBits(path, bit / 8, 1 << (bit % 8));
    ASSERT_FALSE(ReadAll(path).status.ok()) << "bit " << bit % 8 << " of byte " << bit / 8;
    FlipBits(path, bit / 8, 1 << (bit % 8));
  }
}

inline std::string ReadBytes(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return std::string(std::istreambuf_iterator<char>(in), {});
}

inline std::string Number(uint64_t number, size_t bytes) {
  std::string text;
  AppendNumber(number, bytes, &text);
  return text;
}
inline std::string Text(absl::string_view text) {
  return absl::StrCat(Number(text.size(), 4), text);
}

// Records of MCAP.
inline std::string McapRecord(uint8_t op, absl::string_view content) {
  return absl::StrCat(Number(op, 1), Number(content.size(), 8), content);
}
inline std::string McapHeader() {
  return absl::StrCat(kMcapMagic, McapRecord(1, Text("ros2") + Text("test")));
}
inline std::string McapSchema(uint16_t id, absl::string_view name) {
  return McapRecord(3, Number(id, 2) + Text(name) + Text("ros2msg") + Text("string data"));
}
inline std::string McapChannel(uint16_t id, uint16_t schema, absl::string_view topic,
                               absl::string_view encoding = "cdr") {
  return McapRecord(4, Number(id, 2) + Number(schema, 2) + Text(topic) + Text(encoding) +
                           Text(Text("key") + Text("value")));
}
inline std::string McapMessage(uint16_t channel, uint64_t time, absl::string_view payload) {
  return McapRecord(5, absl::StrCat(Number(channel, 2), Number(7, 4), Number(time, 8),
                                    Number(time + 1, 8), payload));
}
inline std::string McapChunk(absl::string_view compression, absl::string_view stored, uint64_t size,
                             uint32_t crc) {
  return McapRecord(6, absl::StrCat(Number(0, 8), Number(9, 8), Number(size, 8), Number(crc, 4),
                                    Text(compression), Number(stored.size(), 8), stored));
}
inline std::string McapDataEnd(uint32_t crc = 0) { return McapRecord(15, Number(crc, 4)); }
inline std::string McapFooter() {
  return absl::StrCat(McapRecord(2, Number(0, 8) + Number(0, 8) + Number(0, 4)), kMcapMagic);
}

// An SQLite file, by statements.
inline void MakeSqlite(const std::string& path, const std::vector<std::string>& statements) {
  sqlite3* database = nullptr;
  ASSERT_EQ(sqlite3_open(path.c_str(), &database), SQLITE_OK);
  for (const std::string& statement : statements) {
    ASSERT_EQ(sqlite3_exec(database, statement.c_str(), nullptr, nullptr, nullptr), SQLITE_OK)
        << sqlite3_errmsg(database) << "\n"
        << statement;
  }
  sqlite3_close(database);
}

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_RECORDING_TEST_DATA_H_
