#include "policy_server/policy/recording/bag_reader.h"

#include <sqlite3.h>

#include <algorithm>
#include <cstdint>
#include <utility>

#include "absl/container/flat_hash_map.h"
#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/types/span.h"
#include "policy_server/policy/recording/bag_copy.h"
#include "policy_server/policy/recording/decompress.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"

namespace rips::recording {
namespace {

// Steps of SQLite's machine: a row of an honest file takes less than 100 in all, and no row takes
// less than 16 bytes of the file.
constexpr uint64_t kStepsBase = 1'000'000;
constexpr uint64_t kStepsPerByte = 32;
constexpr int kStepsPerCall = 1'000;
// Bytes of a row beside the payload.
constexpr size_t kRowBytes = 64 * 1024;

struct CloseDatabase {
  void operator()(sqlite3* database) const { sqlite3_close_v2(database); }
};
struct Finalize {
  void operator()(sqlite3_stmt* statement) const { sqlite3_finalize(statement); }
};
using Statement = std::unique_ptr<sqlite3_stmt, Finalize>;

// `path` as an SQLite URI, without parameters.
std::string UriOf(const std::string& path) {
  std::string uri = "file:";
  for (const char c : path) {
    if (absl::ascii_isalnum(static_cast<unsigned char>(c)) || c == '/' || c == '.' || c == '_' ||
        c == '-') {
      uri.push_back(c);
    } else {
      constexpr char kDigits[] = "0123456789abcdef";
      const auto byte = static_cast<unsigned char>(c);
      uri.append({'%', kDigits[byte >> 4], kDigits[byte & 15]});
    }
  }
  return uri;
}

std::string TextAt(sqlite3_stmt* row, int column) {
  const void* data = sqlite3_column_blob(row, column);
  const int size = sqlite3_column_bytes(row, column);
  if (data == nullptr || size <= 0) return std::string();
  return std::string(static_cast<const char*>(data), static_cast<size_t>(size));
}

class BagReader final : public Reader {
 public:
  explicit BagReader(std::string path) : path_(std::move(path)) {}

  // `bytes` is the length of the file.
  absl::Status Open(uint64_t bytes);
  bool has_graph() const override { return false; }

 private:
  struct Topic {
    std::string name;
    std::string type;
  };

  absl::StatusOr<std::optional<Recorded>> Read() override;

  absl::Status Start(uint64_t bytes);
  absl::Status Connect(const BagCopy& copy);
  absl::Status CheckTable(absl::string_view table, absl::Span<const char* const> columns);
  absl::Status ReadTopics();
  absl::Status AddTopic(sqlite3_stmt* row);
  // The table cannot be read to its end: makes `order_` give the rows that can.
  absl::Status OrderReadable(const absl::Status& why);
  absl::StatusOr<std::optional<Recorded>> ReadRow();
  // Of the message `id`, which must have that timestamp in the table too.
  absl::StatusOr<std::string> ReadPayload(int64_t id, int64_t timestamp);

  absl::StatusOr<Statement> Prepare(absl::string_view sql);
  // False: no further row.
  absl::StatusOr<bool> Step(const Statement& statement);
  absl::Status FromSqlite(int code);
  absl::Status Error(absl::StatusCode code, absl::string_view what) const {
    return absl::Status(code, absl::StrCat("`", path_, "`: ", what));
  }
  absl::Status Damaged(absl::string_view what) const {
    return Error(absl::StatusCode::kDataLoss, what);
  }

  const std::string path_;
  uint64_t steps_left_ = kStepsBase;
  std::unique_ptr<sqlite3, CloseDatabase> database_;
  Statement order_;
  Statement payload_;
  absl::flat_hash_map<int64_t, Topic> topics_;
  // What comes after the last row: OK = the end, else what the file lacks.
  absl::Status end_;
  // Time and id of the message before.
  std::optional<std::pair<int64_t, int64_t>> last_;
};

absl::Status BagReader::FromSqlite(int code) {
  const absl::string_view text = sqlite3_errmsg(database_.get());
  switch (code & 0xff) {
    case SQLITE_INTERRUPT:
      return Damaged("walking through it takes more steps than a file of its length can need");
    case SQLITE_TOOBIG:
      return Error(absl::StatusCode::kResourceExhausted,
                   absl::StrCat("a row exceeds the limit of ", kMessageBytesMax, " bytes"));
    case SQLITE_NOMEM:
    case SQLITE_FULL:
      return Error(absl::StatusCode::kResourceExhausted, absl::StrCat("sqlite: ", text));
    case SQLITE_CANTOPEN:
    case SQLITE_IOERR:
    case SQLITE_PERM:
      // Reading past the end of a cut file is an I/O error too.
      if (code == SQLITE_IOERR_SHORT_READ) break;
      return Error(absl::StatusCode::kUnavailable, absl::StrCat("sqlite: ", text));
    default:
      break;
  }
  return Damaged(absl::StrCat("sqlite: ", text));
}

absl::Status BagReader::Connect(const BagCopy& copy) {
  sqlite3* raw = nullptr;
  const std::string uri =
      absl::StrCat(UriOf(copy.path()), copy.is_copy() ? "?mode=rw" : "?mode=ro&immutable=1");
  const int code = sqlite3_open_v2(uri.c_str(), &raw,
                                   (copy.is_copy() ? SQLITE_OPEN_READWRITE : SQLITE_OPEN_READONLY) |
                                       SQLITE_OPEN_URI | SQLITE_OPEN_NOMUTEX |
                                       SQLITE_OPEN_EXRESCODE | SQLITE_OPEN_PRIVATECACHE,
                                   nullptr);
  database_.reset(raw);
  if (raw == nullptr) return Error(absl::StatusCode::kResourceExhausted, "sqlite: out of memory");
  if (code != SQLITE_OK) return FromSqlite(code);
  sqlite3_limit(raw, SQLITE_LIMIT_LENGTH, static_cast<int>(kMessageBytesMax + kRowBytes));
  sqlite3_db_config(raw, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
  sqlite3_db_config(raw, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
  sqlite3_db_config(raw, SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, 1, nullptr);
  // Without it, a cell that a damaged page has at its end is read from the memory behind the page.
  if (const int checks =
          sqlite3_exec(raw, "PRAGMA cell_size_check = ON", nullptr, nullptr, nullptr);
      checks != SQLITE_OK) {
    return FromSqlite(checks);
  }
  sqlite3_progress_handler(
      raw, kStepsPerCall,
      [](void* left) {
        uint64_t& steps = *static_cast<uint64_t*>(left);
        if (steps < kStepsPerCall) return 1;
        steps -= kStepsPerCall;
        return 0;
      },
      &steps_left_);
  return absl::OkStatus();
}

absl::StatusOr<Statement> BagReader::Prepare(absl::string_view sql) {
  sqlite3_stmt* raw = nullptr;
  const int code =
      sqlite3_prepare_v2(database_.get(), sql.data(), static_cast<int>(sql.size()), &raw, nullptr);
  Statement statement(raw);
  if (code != SQLITE_OK) return FromSqlite(code);
  return statement;
}

absl::StatusOr<bool> BagReader::Step(const Statement& statement) {
  const int code = sqlite3_step(statement.get());
  if (code == SQLITE_ROW) return true;
  if (code == SQLITE_DONE) return false;
  return FromSqlite(code);
}

// A plain table, whose columns are what is stored: a view or a computed column would make us run
// what the file says.
absl::Status BagReader::CheckTable(absl::string_view table, absl::Span<const char* const> columns) {
  const auto invalid = absl::StatusCode::kInvalidArgument;
  RIPS_ASSIGN_OR_RETURN(const Statement list,
                        Prepare("SELECT type FROM pragma_table_list WHERE schema = 'main' AND "
                                "name = ?1"));
  sqlite3_bind_text(list.get(), 1, table.data(), static_cast<int>(table.size()), SQLITE_STATIC);
  RIPS_ASSIGN_OR_RETURN(const bool found, Step(list));
  if (!found) return Error(invalid, absl::StrCat("not a rosbag2 bag: no table `", table, "`"));
  if (TextAt(list.get(), 0) != "table") {
    return Error(invalid, absl::StrCat("`", table, "` is not a plain table"));
  }
  RIPS_ASSIGN_OR_RETURN(const Statement info, Prepare("SELECT name, hidden, pk, upper(type) FROM "
                                                      "pragma_table_xinfo(?1)"));
  sqlite3_bind_text(info.get(), 1, table.data(), static_cast<int>(table.size()), SQLITE_STATIC);
  size_t seen = 0;
  while (true) {
    RIPS_ASSIGN_OR_RETURN(const bool row, Step(info));
    if (!row) break;
    const std::string name = TextAt(info.get(), 0);
    const bool wanted = std::find(columns.begin(), columns.end(), name) != columns.end();
    const bool key = sqlite3_column_int(info.get(), 2) == 1 && TextAt(info.get(), 3) == "INTEGER";
    if (sqlite3_column_int(info.get(), 1) != 0 || (name == "id" && !key)) {
      return Error(invalid, absl::StrCat("column `", ros2::Printable(name), "` of `", table,
                                         "` is not as rosbag2 makes it"));
    }
    if (wanted) ++seen;
  }
  if (seen == columns.size()) return absl::OkStatus();
  return Error(invalid, absl::StrCat("not a rosbag2 bag: `", table, "` lacks one of the columns ",
                                     absl::StrJoin(columns, ", ")));
}

absl::Status BagReader::AddTopic(sqlite3_stmt* row) {
  for (const int column : {1, 2, 3}) {
    if (sqlite3_column_type(row, column) == SQLITE_TEXT) continue;
    return Damaged("a topic's name, type or serialization format is not a text");
  }
  Topic topic{.name = TextAt(row, 1), .type = TextAt(row, 2)};
  const std::string format = TextAt(row, 3);
  const std::string shown = ros2::Printable(topic.name);
  if (topic.name.size() > kNameBytesMax || topic.type.size() > kNameBytesMax) {
    return Error(absl::StatusCode::kResourceExhausted,
                 absl::StrCat("topic `", shown, "`: its name or type exceeds the limit of ",
                              kNameBytesMax, " bytes"));
  }
  if (format != "cdr") {
    return Error(absl::StatusCode::kInvalidArgument,
                 absl::StrCat("topic `", shown, "` is serialized as `", ros2::Printable(format),
                              "`; only `cdr` can be replayed"));
  }
  if (topics_.size() >= kBagTopicsMax) {
    return Error(absl::StatusCode::kResourceExhausted,
                 absl::StrCat("more topics than the limit of ", kBagTopicsMax));
  }
  if (!topics_.emplace(sqlite3_column_int64(row, 0), std::move(topic)).second) {
    return Damaged("two topics have the same id");
  }
  return absl::OkStatus();
}

absl::Status BagReader::ReadTopics() {
  RIPS_ASSIGN_OR_RETURN(const Statement rows,
                        Prepare("SELECT id, name, type, serialization_format FROM topics "
                                "ORDER BY id"));
  while (true) {
    RIPS_ASSIGN_OR_RETURN(const bool row, Step(rows));
    if (!row) return absl::OkStatus();
    RIPS_RETURN_IF_ERROR(AddTopic(rows.get()));
  }
}

absl::Status BagReader::Open(uint64_t bytes) {
  const absl::Status started = Start(bytes);
  return absl::IsDataLoss(started) && !end_.ok() ? end_ : started;
}

absl::Status BagReader::Start(uint64_t bytes) {
  const absl::StatusOr<std::unique_ptr<BagCopy>> copy = BagCopy::Make(path_, bytes);
  if (!copy.ok()) return Error(copy.status().code(), copy.status().message());
  if (!(*copy)->end().ok()) end_ = Damaged((*copy)->end().message());
  steps_left_ += kStepsPerByte * (*copy)->bytes();
  RIPS_RETURN_IF_ERROR(Connect(**copy));
  constexpr const char* kTopics[] = {"id", "name", "type", "serialization_format"};
  constexpr const char* kMessages[] = {"id", "topic_id", "timestamp", "data"};
  RIPS_RETURN_IF_ERROR(CheckTable("topics", kTopics));
  RIPS_RETURN_IF_ERROR(CheckTable("messages", kMessages));
  RIPS_RETURN_IF_ERROR(ReadTopics());
  // Without the payload, which would be sorted too; and without an index, which may be damaged and
  // lack what the table has.
  RIPS_ASSIGN_OR_RETURN(order_, Prepare("SELECT id, topic_id, timestamp FROM messages "
                                        "NOT INDEXED ORDER BY timestamp, id"));
  RIPS_ASSIGN_OR_RETURN(payload_, Prepare("SELECT data, timestamp FROM messages WHERE id = ?1"));
  return absl::OkStatus();
}

absl::StatusOr<std::string> BagReader::ReadPayload(int64_t id, int64_t timestamp) {
  sqlite3_reset(payload_.get());
  sqlite3_bind_int64(payload_.get(), 1, id);
  RIPS_ASSIGN_OR_RETURN(const bool row, Step(payload_));
  if (!row || sqlite3_column_int64(payload_.get(), 1) != timestamp) {
    return Damaged(absl::StrCat("message ", id, " is in an index only, or differs there"));
  }
  if (sqlite3_column_type(payload_.get(), 0) != SQLITE_BLOB) {
    return Damaged(absl::StrCat("the data of message ", id, " is not a blob"));
  }
  std::string payload = TextAt(payload_.get(), 0);
  sqlite3_reset(payload_.get());
  if (payload.size() > kMessageBytesMax) {
    return Error(absl::StatusCode::kResourceExhausted,
                 absl::StrCat("message ", id, " of ", payload.size(),
                              " bytes exceeds the limit of ", kMessageBytesMax));
  }
  if (absl::StartsWith(payload, kZstdMagic)) {
    return Error(absl::StatusCode::kInvalidArgument,
                 absl::StrCat("message ", id, " ", kCompressedMessage));
  }
  return payload;
}

absl::Status BagReader::OrderReadable(const absl::Status& why) {
  // Not one that walks in circles.
  if (steps_left_ < kStepsPerCall) return why;
  // A page is checked when it is read, and one that has failed would pass the next time.
  order_.reset();
  sqlite3_db_release_memory(database_.get());
  RIPS_ASSIGN_OR_RETURN(const Statement rows,
                        Prepare("SELECT id, topic_id, timestamp FROM messages "
                                "NOT INDEXED ORDER BY id"));
  uint64_t readable = 0;
  while (true) {
    const absl::StatusOr<bool> row = Step(rows);
    if (!row.ok() || !*row) break;
    ++readable;
  }
  if (readable == 0) return why;
  // The row after the last of them is not touched.
  RIPS_ASSIGN_OR_RETURN(
      order_, Prepare(absl::StrCat("SELECT id, topic_id, timestamp FROM (SELECT id, topic_id, "
                                   "timestamp FROM messages NOT INDEXED ORDER BY id LIMIT ",
                                   readable, ") ORDER BY timestamp, id")));
  return absl::OkStatus();
}

absl::StatusOr<std::optional<Recorded>> BagReader::Read() {
  absl::StatusOr<std::optional<Recorded>> event = ReadRow();
  // Sorting reads all rows before the first is given.
  if (absl::IsDataLoss(event.status()) && !last_) {
    if (end_.ok()) end_ = event.status();
    RIPS_RETURN_IF_ERROR(OrderReadable(end_));
    event = ReadRow();
  }
  // That the file is cut says more than what was found broken by that.
  if (end_.ok() || (event.ok() && event->has_value())) return event;
  if (!event.ok() && !absl::IsDataLoss(event.status())) return event;
  return end_;
}

absl::StatusOr<std::optional<Recorded>> BagReader::ReadRow() {
  RIPS_ASSIGN_OR_RETURN(const bool row, Step(order_));
  if (!row) return std::nullopt;
  for (const int column : {0, 1, 2}) {
    if (sqlite3_column_type(order_.get(), column) == SQLITE_INTEGER) continue;
    return Damaged("the id, topic_id or timestamp of a message is not a number");
  }
  const int64_t id = sqlite3_column_int64(order_.get(), 0);
  const int64_t topic_id = sqlite3_column_int64(order_.get(), 1);
  const std::pair<int64_t, int64_t> place(sqlite3_column_int64(order_.get(), 2), id);
  if (last_ && place <= *last_) {
    return Damaged(absl::StrCat("message ", id, " comes twice or out of order"));
  }
  last_ = place;
  const auto topic = topics_.find(topic_id);
  if (topic == topics_.end()) {
    return Damaged(
        absl::StrCat("message ", id, " is of topic ", topic_id, ", which the bag does not have"));
  }
  RIPS_ASSIGN_OR_RETURN(std::string payload, ReadPayload(id, place.first));
  const auto bytes = static_cast<uint32_t>(payload.size());
  return Recorded{.time_unix_ns = place.first,
                  .what = RecordedMessage{.topic = topic->second.name,
                                          .type = topic->second.type,
                                          .payload = std::move(payload),
                                          .size_bytes = bytes}};
}

}  // namespace

absl::StatusOr<std::unique_ptr<Reader>> OpenBagFile(const std::string& path, uint64_t bytes) {
  auto reader = std::make_unique<BagReader>(path);
  RIPS_RETURN_IF_ERROR(reader->Open(bytes));
  return reader;
}

}  // namespace rips::recording
