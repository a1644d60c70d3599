import "./style.css";
import { startPage } from "./start";

startPage();
