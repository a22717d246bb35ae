#include "policy_server/policy/recording/rips_format.h"

#include <fcntl.h>
#include <unistd.h>

#include "policy_server/policy/recording/recording_test_data.h"
#include "policy_server/policy/recording/rips_reader.h"
#include "policy_server/policy/recording/rips_writer.h"

namespace rips::recording {
namespace {

using ::testing::HasSubstr;
using ::testing::SizeIs;

constexpr auto kDataLoss = absl::StatusCode::kDataLoss;
constexpr auto kInvalid = absl::StatusCode::kInvalidArgument;
constexpr auto kExhausted = absl::StatusCode::kResourceExhausted;

const RecordedOrigin kOrigin = {
    .robot = "r1",
    .bundle_id = "abcd",
    .level = "ALERT",
    .start_unix_ns = -5,
    .rips_version = "0.1.0",
    .variables = {{"b", true}, {"f", 0.5}, {"i", int64_t{-7}}, {"s", std::string("l\u00e9")}},
    .uptime_ns = 12,
    .alerts = {{.id = "a", .rule = "r", .severity = "high", .text = "t", .time_unix_ns = 4},
               {.id = "b"}}};

RecordedGraph Graph() {
  RecordedGraph graph{.whole = true, .settled = true};
  const ros2::Guid guid = *ros2::GuidFromBytes("PARTICIPANT1" + std::string("\0\0\1\xc1", 4));
  graph.content.upsert_participants.push_back({.guid = guid, .host = "h"});
  graph.content.upsert_nodes.push_back({.full_name = "/n", .participant = guid});
  return graph;
}

// One event of each kind, and some of their corners.
std::vector<Recorded> Events() {
  std::vector<Recorded> events;
  events.push_back({.time_unix_ns = 1, .what = Graph()});
  events.push_back({.time_unix_ns = 2,
                    .context = Graph(),
                    .what = RecordedMessage{.topic = "/t",
                                            .type = "p/msg/T",
                                            .sender = "/n",
                                            .writer = *ros2::GuidFromBytes("0123456789abcdef"),
                                            .payload = std::string("\0\xff", 2),
                                            .size_bytes = 9,
                                            .truncated = true}});
  events.push_back({.what = RecordedMessage{.topic = "/t"}});
  RecordedGraph delta;
  delta.content.gone_nodes = {"/n"};
  events.push_back({.time_unix_ns = 1, .what = delta});
  events.push_back({.what = RecordedGraph{}});
  events.push_back({.what = model::IdsAlert{.source = "snort",
                                            .gid = 1,
                                            .sid = 2,
                                            .message = "m",
                                            .src = "s",
                                            .dst = "d",
                                            .line = "l\u00e9"}});
  events.push_back({.time_unix_ns = 0, .what = model::SignalSeen{.name = "SIGUSR1"}});
  events.push_back({.what = model::AgentEvent{.agent = "sensor", .state = "lost"}});
  events.push_back({.what = model::Finding{.kind = "impostor"}});
  model::Finding finding{
      .kind = "non_ros_writer", .node = "/n", .topic = "/t", .detail = "for people"};
  finding.guid.bytes[15] = 3;
  events.push_back({.what = finding});
  events.push_back({.what = model::Loss{.count = UINT64_MAX}});
  events.push_back({.what = model::Loss{.count = 2,
                                        .topic = "/a",
                                        .type = "a/msg/A",
                                        .writer = *ros2::GuidFromBytes("0123456789abcdef"),
                                        .first_ns = 5,
                                        .last_ns = 9,
                                        .cause = "queue full"}});
  events.push_back({.what = RecordedOther{.what = "tick"}});
  events.push_back({.time_unix_ns = 9,
                    .what = RecordedLevel{.to = "HALT", .cause = "operator alice"},
                    .blind = true});
  events.push_back({.what = model::TickEvent{}, .blind = false, .late = true});
  engine::StandingFindings standing(/*told_all=*/true);
  events.push_back({.what = model::TickEvent{}, .findings = standing});
  standing.Add("impostor");
  standing.Add("of_a_later_version");
  events.push_back({.what = model::TickEvent{}, .findings = standing});
  events.push_back({.what = model::TickEvent{}, .findings = engine::StandingFindings()});
  for (size_t i = 0; i < events.size(); ++i) events[i].index = i;
  return events;
}

class RipsFormatTest : public testing::Test {
 protected:
  ~RipsFormatTest() override {
    if (fd_ >= 0) close(fd_);
  }
  absl::StatusOr<RipsWriter> MakeWriter(const std::string& path = {}) {
    if (fd_ >= 0) close(fd_);
    fd_ = open(path.empty() ? path_.c_str() : path.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
    return RipsWriter::Create(fd_, kOrigin);
  }
  // The bytes of a recording of `events`.
  std::string Record(const std::vector<Recorded>& events) {
    auto writer = MakeWriter();
    EXPECT_THAT(writer, IsOk());
    for (const Recorded& event : events) EXPECT_THAT(writer->Append(event), IsOk());
    return ReadBytes(path_);
  }
  Reading Read(absl::string_view bytes) { return ReadAll(folder_.Write("read.rec", bytes)); }

  const TempFolder folder_;
  const std::string path_ = folder_.File("written.rec");
  int fd_ = -1;
};

std::string Frame(absl::string_view body) {
  return absl::StrCat(Number(body.size(), 4), Number(Crc32(0, body), 4), body);
}

TEST_F(RipsFormatTest, EventsReadBackAsTheyWereWritten) {
  Record(Events());

  const Reading reading = ReadAll(path_);

  ASSERT_THAT(reading.status, IsOk());
  EXPECT_EQ(Print(reading.events), Print(Events()));
  EXPECT_EQ(reading.events[2].time_unix_ns, std::nullopt);
  EXPECT_EQ(reading.events[6].time_unix_ns, 0);
  EXPECT_EQ(MessageOf(reading.events[1]), MessageOf(Events()[1]));
  const auto reader = Open(path_);
  ASSERT_THAT(reader, IsOk());
  EXPECT_TRUE((*reader)->has_graph());
  EXPECT_EQ(*(*reader)->origin(), kOrigin);
}

// The example of FORMAT.md.
TEST_F(RipsFormatTest, BytesAreAsTheFormatSays) {
  const std::string empty = Record({});
  const std::string one =
      Record({{.time_unix_ns = 10, .what = model::SignalSeen{.name = "SIGUSR1"}}});
  EXPECT_EQ(empty.substr(0, 8), absl::string_view("\x89RIPS\x01\r\n", 8));
  EXPECT_EQ(
      one.substr(empty.size()),
      absl::string_view("\x0f\0\0\0\x95\xd0\x93\x20\x08\x0a\x3a\x0b\x0a\x07SIGUSR1\x10\x01", 23));
}

TEST_F(RipsFormatTest, SeesEveryCut) {
  const std::string bytes = Record(Events());
  std::vector<size_t> whole;  // a cut between two frames leaves a recording
  const std::string first = Record({});
  for (size_t at = first.size(); at < bytes.size();) {
    whole.push_back(at);
    at += kFrameHeaderBytes + Cursor(absl::string_view(bytes).substr(at)).U32();
  }
  ASSERT_THAT(whole, SizeIs(Events().size()));
  ExpectCutsAreSeen(
      bytes, [&](size_t cut) { return std::find(whole.begin(), whole.end(), cut) != whole.end(); });
  const size_t last = whole.back();
  EXPECT_THAT(
      Read(bytes.substr(0, bytes.size() - 1)).status,
      StatusIs(kDataLoss, HasSubstr(absl::StrCat("byte ", last, ": the recording is cut"))));
}

TEST_F(RipsFormatTest, SeesEveryFlippedBit) {
  const std::string bytes = Record(Events());
  ExpectFlipsAreSeen(bytes, 0, bytes.size());
}

TEST_F(RipsFormatTest, RefusesWhatIsMalformed) {
  const std::string empty = Record({});
  rips::v1::RecordedEvent guid;
  guid.mutable_message()->set_writer_guid("short");
  rips::v1::RecordedEvent size;
  size.mutable_message()->set_payload("abc");
  rips::v1::RecordedEvent kind;
  kind.mutable_snapshot()->add_endpoints()->set_guid("0123456789abcdef");
  const std::pair<std::string, const char*> cases[] = {
      {empty + std::string(64, '\0'), "a frame of 0 bytes"},
      {empty + Number(kFrameBytesMax + 1, 4) + Number(0, 4), "a frame of 68157441 bytes"},
      {empty + Number(UINT32_MAX, 4) + Number(0, 4), "a frame of 4294967295 bytes"},
      {empty + Number(1'000, 4) + Number(0, 4), "cut within a frame of 1000 bytes"},
      {empty + Number(1, 4) + Number(0, 4) + "x", "the frame's checksum is 00000000"},
      {empty + Frame("\xff\xff\xff\xff"), "the event cannot be decoded"},
      {std::string(kRipsMagic) + Frame("\xff\xff"), "the header cannot be decoded"},
      {empty + Frame(guid.SerializeAsString()), "bytes"},
      {empty + Frame(size.SerializeAsString()), "a message of 0 bytes, not truncated, holds 3"},
      {empty + Frame(kind.SerializeAsString()), "kind 0"},
  };
  for (const auto& [bytes, text] : cases) {
    EXPECT_THAT(Read(bytes).status, StatusIs(kDataLoss, HasSubstr(text)));
    EXPECT_THAT(std::string(Read(bytes).status.message()), HasSubstr("read.rec`: byte "));
  }
}

TEST_F(RipsFormatTest, AnEventOfTheFutureKeepsItsPlace) {
  const std::string bytes = Record(Events()) + Frame("\xca\x3e\x01x");  // field 1001
  const Reading reading = Read(bytes);
  ASSERT_THAT(reading.status, IsOk());
  EXPECT_EQ(std::get<RecordedOther>(reading.events.back().what).what, "unknown");
  EXPECT_EQ(reading.events.back().index, Events().size());
}

TEST_F(RipsFormatTest, TheWriterRefusesWhatCouldNotBeRead) {
  auto writer = MakeWriter();
  ASSERT_THAT(writer, IsOk());
  const std::string before = ReadBytes(path_);
  RecordedGraph half = Graph();
  half.whole = false;
  RecordedGraph gone = Graph();
  gone.content.gone_nodes = {"/x"};
  EXPECT_THAT(writer->Append({.what = model::SignalSeen{.name = "\xff"}}),
              StatusIs(kInvalid, HasSubstr("`name` of `SignalSeen` is not UTF-8")));
  RecordedGraph bad_text;
  bad_text.content.gone_nodes = {"good", "\xc0\x80"};
  EXPECT_THAT(writer->Append({.what = bad_text}), StatusIs(kInvalid, HasSubstr("gone_nodes")));
  EXPECT_THAT(writer->Append({.what = RecordedMessage{.payload = "x"}}), StatusIs(kInvalid));
  EXPECT_THAT(writer->Append({.what = RecordedMessage{.size_bytes = 1}}), StatusIs(kInvalid));
  EXPECT_THAT(writer->Append({.context = half, .what = RecordedOther{}}),
              StatusIs(kInvalid, HasSubstr("must be whole")));
  EXPECT_THAT(writer->Append({.what = gone}), StatusIs(kInvalid, HasSubstr("takes something")));
  RecordedMessage large{.payload = std::string(kMessageBytesMax + 1, 'x')};
  large.size_bytes = static_cast<uint32_t>(large.payload.size());
  EXPECT_THAT(writer->Append({.what = large}), StatusIs(kExhausted, HasSubstr("67108864")));
  large.payload.pop_back();
  --large.size_bytes;
  large.topic = std::string(2 << 20, 't');
  EXPECT_THAT(writer->Append({.what = large}), StatusIs(kExhausted, HasSubstr("68157440")));
  EXPECT_EQ(ReadBytes(path_), before) << "nothing was written";

  large.topic = "/t";
  ASSERT_THAT(writer->Append({.what = large}), IsOk()) << "exactly the limit, after refusals";
  const Reading reading = ReadAll(path_);
  ASSERT_THAT(reading.status, IsOk());
  EXPECT_EQ(MessageOf(reading.events[0]), large);
}

TEST_F(RipsFormatTest, AFullDiskIsAnErrorThatStays) {
  EXPECT_THAT(MakeWriter("/dev/full"), StatusIs(kExhausted, HasSubstr("cannot write")));
  auto writer = MakeWriter();
  ASSERT_THAT(writer, IsOk());
  const int full = open("/dev/full", O_WRONLY);
  ASSERT_EQ(dup2(full, fd_), fd_);
  close(full);
  EXPECT_THAT(writer->Append({.what = RecordedOther{}}), StatusIs(kExhausted));
  close(std::exchange(fd_, -1));
  EXPECT_THAT(writer->Append({.what = RecordedOther{}}), StatusIs(kExhausted));
}

}  // namespace
}  // namespace rips::recording
